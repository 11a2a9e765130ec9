"""Workbooks: the cells of a sheet are understood as the text that a spreadsheet exports."""

import io
import json
import sys
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recording import TextOptions, read_recording, write_recording
from piezod.recording.formats.spreadsheet import run_child
from tests.benches.messy_files import recorded

pytest.importorskip("python_calamine", reason="python-calamine is not installed")

NAMESPACE = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
RELATIONS = "http://schemas.openxmlformats.org"


def workbook(path: Path, sheets: dict[str, list[list]]) -> Path:
    """A workbook as ECMA-376 part 1 describes it, with texts inside their cells."""

    def cell(value):
        if value is None:
            return "<c/>"
        if isinstance(value, str):
            return f'<c t="inlineStr"><is><t>{value}</t></is></c>'
        return f"<c><v>{value!r}</v></c>"

    numbers = range(1, len(sheets) + 1)
    types = "".join(
        f'<Override PartName="/xl/worksheets/sheet{k}.xml" '
        'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.worksheet+xml"/>'
        for k in numbers
    )
    listed = "".join(
        f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for k, name in zip(numbers, sheets, strict=True)
    )
    office = f"{RELATIONS}/officeDocument/2006/relationships"
    related = "".join(
        f'<Relationship Id="r{k}" Type="{office}/worksheet" Target="worksheets/sheet{k}.xml"/>' for k in numbers
    )
    with zipfile.ZipFile(path, "w") as file:
        file.writestr(
            "[Content_Types].xml",
            f'<Types xmlns="{RELATIONS}/package/2006/content-types"><Default Extension="rels" '
            'ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
            '<Override PartName="/xl/workbook.xml" '
            'ContentType="application/vnd.openxmlformats-officedocument.spreadsheetml.sheet.main+xml"/>'
            f"{types}</Types>",
        )
        file.writestr(
            "_rels/.rels",
            f'<Relationships xmlns="{RELATIONS}/package/2006/relationships">'
            f'<Relationship Id="r1" Type="{office}/officeDocument" Target="xl/workbook.xml"/></Relationships>',
        )
        file.writestr(
            "xl/workbook.xml", f'<workbook {NAMESPACE} xmlns:r="{office}"><sheets>{listed}</sheets></workbook>'
        )
        file.writestr(
            "xl/_rels/workbook.xml.rels",
            f'<Relationships xmlns="{RELATIONS}/package/2006/relationships">{related}</Relationships>',
        )
        for k, rows in zip(numbers, sheets.values(), strict=True):
            text = "".join(f"<row>{''.join(map(cell, row))}</row>" for row in rows)
            file.writestr(
                f"xl/worksheets/sheet{k}.xml", f"<worksheet {NAMESPACE}><sheetData>{text}</sheetData></worksheet>"
            )
    return path


def rows(names):
    time_s, voltage_V, force_N = recorded()
    return [names, *zip((1e3 * time_s).tolist(), voltage_V.tolist(), (1e-3 * force_N).tolist(), strict=True)]


def test_the_sheet_with_the_numbers_is_read_with_its_names_and_units(tmp_path):
    cover = [["Prüfstand 4", None], ["Datum", "2026-11-03"]]
    path = workbook(tmp_path / "rec.xlsx", {"Deckblatt": cover, "Daten": rows(["Zeit [ms]", "U [V]", "Kraft [kN]"])})
    read = read_recording(path)
    time_s, voltage_V, force_N = recorded()
    np.testing.assert_allclose(read.time_s, time_s, atol=1e-12)
    np.testing.assert_allclose(read.channels["voltage_V"], voltage_V, rtol=1e-12)
    np.testing.assert_allclose(read.channels["force_kN"], 1e-3 * force_N, rtol=1e-12)
    assert read.source == str(path)
    assert read.metadata["understood"].startswith("sheet 'Daten', time in ms from 'Zeit [ms]', voltage_V from 'U [V]'")


def test_columns_without_names_are_named_by_the_user(tmp_path):
    path = workbook(tmp_path / "rec.xlsx", {"1": rows([])[1:]})
    read = read_recording(path, TextOptions(columns=("time_ms", "voltage_V", "force_kN")))
    assert set(read.channels) == {"voltage_V", "force_kN"}


@pytest.mark.parametrize(
    ("sheets", "says"),
    [
        ({"Notes": [["nothing", "here"]]}, "rec.xlsx: holds no table of numbers in its sheets 'Notes'"),
        ({"Data": rows(["U [V]", "F [N]", "T [degC]"])}, "rec.xlsx, sheet 'Data': has no column of time"),
    ],
)
def test_a_workbook_without_a_recording_is_refused_by_the_name_of_its_sheet(tmp_path, sheets, says):
    with pytest.raises(RecordingError, match=says):
        read_recording(workbook(tmp_path / "rec.xlsx", sheets))


def test_a_workbook_is_no_csv_and_is_not_written(tmp_path):
    path = workbook(tmp_path / "rec.xlsx", {"1": rows(["time_ms", "voltage_V", "force_kN"])})
    recording = read_recording(path)
    with pytest.raises(RecordingError, match="read only"):
        write_recording(recording, tmp_path / "other.xlsx")
    renamed = path.rename(tmp_path / "rec.csv")
    with pytest.raises(RecordingError, match="holds a workbook, its suffix says CSV; rename it"):
        read_recording(renamed)


def test_a_system_that_sets_no_limits_reads_a_workbook(tmp_path, monkeypatch, capsys):
    rows = [["time_s", "force_N"], *([0.01 * k, 2.0 * k] for k in range(20))]
    path = workbook(tmp_path / "book.xlsx", {"notes": [["text"]], "run": rows})
    request = {"path": str(path), "exported": str(tmp_path / "run.tsv"), "options": asdict(TextOptions())}
    monkeypatch.setitem(sys.modules, "resource", None)
    monkeypatch.setattr("sys.stdin", io.StringIO(json.dumps(request)))
    run_child()
    assert json.loads(capsys.readouterr().out) == {"sheet": "run"}
