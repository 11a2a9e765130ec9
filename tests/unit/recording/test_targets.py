"""Targets are checked before the work, nothing is replaced without --force, and a foreign file takes no resources."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from piezod.errors import ConfigurationError, RecordingError, UsageError
from piezod.recording import column_names, read_recording
from piezod.recording.targets import check_absent, check_folder, check_page

ROWS = "time_s,voltage_V,force_N\n" + "".join(f"{k / 100},{k},{k}\n" for k in range(40))


def piezod(*arguments, limits=""):
    command = f"{limits} exec {sys.executable} -m piezod " + " ".join(map(str, arguments))
    return subprocess.run(["/bin/bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text(ROWS, encoding="utf-8")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".H5", ".mat"])
def test_a_model_is_not_written_under_the_suffix_of_a_recording(recording, tmp_path, suffix):
    done = piezod("identify", recording, "-o", tmp_path / f"model{suffix}")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "a model is written as .yaml" in done.stderr
    assert not (tmp_path / f"model{suffix}").exists()


def test_a_folder_in_place_of_a_recording_is_named(tmp_path):
    with pytest.raises(RecordingError, match="is a folder, must be a recording"):
        read_recording(tmp_path)


@pytest.mark.parametrize("kind", ["file", "link to nothing", "folder"])
def test_an_existing_target_is_replaced_only_with_force(tmp_path, kind):
    path = tmp_path / "there.csv"
    {"file": path.touch, "link to nothing": lambda: path.symlink_to("nothing"), "folder": path.mkdir}[kind]()
    with pytest.raises(UsageError, match="already exists; name another file, or replace it with --force"):
        check_absent(path, force=False)
    check_absent(path, force=True)
    check_absent(tmp_path / "new.csv", force=False)


def test_convert_replaces_a_file_only_with_force(recording, tmp_path):
    target = tmp_path / "out.csv"
    target.write_text("precious", encoding="utf-8")
    done = piezod("convert", recording, "-o", target)
    assert (done.returncode, target.read_text(encoding="utf-8")) == (2, "precious")
    assert done.stderr.count("\n") == 1
    assert piezod("convert", recording, "-o", target, "--force").returncode == 0
    assert target.read_text(encoding="utf-8").startswith("time_s,")


def test_a_diagnosis_into_a_file_is_refused_before_the_recording_is_read(tmp_path):
    (tmp_path / "out").touch()
    done = piezod("diagnose", tmp_path / "missing.csv", "--model", tmp_path / "missing.yaml", "-o", tmp_path / "out")
    assert done.returncode == 78
    assert "out is a file, must be a folder" in done.stderr


def test_a_folder_below_a_file_and_one_with_findings_are_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match="file is a file, must be a folder"):
        check_folder(tmp_path / "file" / "sub")
    (tmp_path / "findings.json").touch()
    with pytest.raises(UsageError, match="--force"):
        check_folder(tmp_path, ("findings.json",), force=False)
    check_folder(tmp_path / "new" / "sub", ("findings.json",), force=False)


def test_a_page_in_a_missing_folder_or_in_the_place_of_a_folder_is_refused(tmp_path):
    for page in (tmp_path / "missing" / "page.html", tmp_path):
        with pytest.raises(ConfigurationError, match="cannot be written"):
            check_page(page)
    check_page(None)


@pytest.mark.parametrize("suffix", [".csv", ".txt", ".h5", ".xlsx", ".sqlite"])
@pytest.mark.parametrize("read", [read_recording, column_names])
def test_a_fifo_is_refused_at_once(tmp_path, suffix, read):
    path = tmp_path / f"rec{suffix}"
    os.mkfifo(path)
    with pytest.raises(RecordingError, match="must be a regular file"):
        read(path)


def test_a_device_is_refused_at_once(tmp_path):
    path = tmp_path / "rec.csv"
    path.symlink_to("/dev/zero")
    with pytest.raises(RecordingError, match="must be a regular file"):
        read_recording(path)


def _book(path: Path, rows: bytes) -> None:
    kind = "http://schemas.openxmlformats.org"
    main, links = f"{kind}/spreadsheetml/2006/main", f"{kind}/officeDocument/2006/relationships"
    parts = {
        "_rels/.rels": ("officeDocument", "xl/workbook.xml"),
        "xl/_rels/workbook.xml.rels": ("worksheet", "worksheets/sheet1.xml"),
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        for name, (role, target) in parts.items():
            text = f'<Relationship Id="rId1" Type="{links}/{role}" Target="{target}"/>'
            book.writestr(name, f'<Relationships xmlns="{kind}/package/2006/relationships">{text}</Relationships>')
        sheets = '<sheets><sheet name="S" sheetId="1" r:id="rId1"/></sheets>'
        book.writestr("xl/workbook.xml", f'<workbook xmlns="{main}" xmlns:r="{links}">{sheets}</workbook>')
        book.writestr(
            "xl/worksheets/sheet1.xml",
            f'<worksheet xmlns="{main}"><sheetData>'.encode() + rows + b"</sheetData></worksheet>",
        )


def test_a_workbook_that_claims_17_thousand_million_cells_is_refused_in_one_line(tmp_path):
    pytest.importorskip("python_calamine", reason="python-calamine is not installed")
    path = tmp_path / "bomb.xlsx"
    cell = b'<row r="%d"><c r="%s"><v>1</v></c></row>'
    _book(path, cell % (1, b"A1") + cell % (1048576, b"XFD1048576"))
    with pytest.raises(RecordingError, match=r"bomb\.xlsx: cannot be read: it needs more than 2 GiB"):
        read_recording(path)


@pytest.mark.parametrize("limits", ["ulimit -n 9;", "ulimit -n 12;", "ulimit -n 16;"])
def test_few_descriptors_are_named_in_one_line(recording, tmp_path, limits):
    done = piezod("convert", recording, "-o", tmp_path / "out.h5", limits=limits)
    assert "Traceback" not in done.stderr
    assert done.returncode == 0 or done.stderr.count("\n") == 1
