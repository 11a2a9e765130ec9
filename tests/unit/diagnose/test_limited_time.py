"""A diagnosis with a limited time: it ends with an answer, and says what was not compared."""

import json

import numpy as np
import pytest

import piezod
from piezod.diagnose.command import diagnose_files
from tests.benches.plain_stack import record, triangles, work


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model, and a recording of its bench with a gain that falls by a tenth."""
    folder = tmp_path_factory.mktemp("limited")
    identification = record(folder / "identification.csv", triangles([100, 40, 80, 60, 100, 30]), 1)
    piezod.identify(str(identification)).model.save(folder / "model.yaml")
    header, *rows = record(folder / "work.csv", work(3, 12.0), 2).read_text(encoding="utf-8").splitlines()
    cells = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    cells[:, header.split(",").index("force_N")] *= np.linspace(1.0, 0.9, len(cells))
    np.savetxt(folder / "work.csv", cells, "%.9g", ",", header=header, comments="")
    return folder


def diagnosed(folder, within_s):
    out = folder / f"out {within_s}"
    diagnosis = diagnose_files(
        [folder / "work.csv"], folder / "model.yaml", out, None, None, lambda *_: None, within_s=within_s
    )
    return diagnosis, json.loads((out / "findings.json").read_text(encoding="utf-8"))


def test_a_time_that_is_over_at_once_gives_an_answer_without_effects_and_says_why(folder):
    diagnosis, findings = diagnosed(folder, 1e-3)
    assert findings["ended_early"]
    assert findings["effects"] == []
    assert findings["verdict"] == "unexplained"
    assert "time was over" in diagnosis.findings.words
    assert any("--within" in note for note in findings["notes"])
    assert diagnosis.findings.law is None


def test_a_time_that_suffices_changes_nothing(folder):
    _, limited = diagnosed(folder, 1e4)
    _, unlimited = diagnosed(folder, None)
    assert not limited["ended_early"]
    assert [effect["name"] for effect in limited["effects"]] == ["gain_drift"]
    assert limited["effects"] == unlimited["effects"]
    assert limited["notes"] == unlimited["notes"]
