"""Readings that a converter clips."""

import json

import numpy as np
import pytest

import piezod
from piezod.diagnose.command import diagnose_files
from tests.benches.plain_stack import RATE_HZ, read, triangles

PEAKS_V = ([100, 40, 80, 60, 100, 30], [90, 50, 100, 70, 35, 80, 95])


def record(path, peaks_V, seed, low_N=-np.inf, high_N=np.inf):
    voltage_V = triangles(peaks_V)
    reading_N = np.clip(read(voltage_V, seed), low_N, high_N)
    columns = np.column_stack((np.arange(voltage_V.size) / RATE_HZ, voltage_V, reading_N))
    np.savetxt(path, columns, "%.6f", ",", header="time_s,voltage_V,force_N", comments="")
    return path


@pytest.mark.parametrize(
    ("low_N", "high_N", "told"), [(-np.inf, 50.0, "clipped at 50 N"), (10.0, np.inf, "clipped at 10 N")]
)
def test_a_limit_of_the_reading_is_told_as_such_and_is_no_effect(tmp_path, low_N, high_N, told):
    model = tmp_path / "model.yaml"
    piezod.identify(str(record(tmp_path / "first.csv", PEAKS_V[0], 1))).model.save(model)
    work = record(tmp_path / "work.csv", PEAKS_V[1], 2, low_N, high_N)
    diagnose_files([work], model, tmp_path / "out", None, None, lambda *_: None)
    findings = json.loads((tmp_path / "out" / "findings.json").read_text(encoding="utf-8"))
    assert [one["name"] for one in findings["effects"]] == []
    assert any(told in note for note in findings["notes"])
