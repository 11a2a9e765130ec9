"""A creep of the force, behind a softening force law: no sum of an effect of the stroke and of minor loops."""

import numpy as np
import pytest

import piezod
from tests.benches.plain_stack import RATE_HZ, triangles

THRESHOLDS_V, WEIGHTS = np.array([5.0, 15.0]), np.array([0.2, 0.2])
PER_DECADE, NOISE_N = 0.02, 0.05
TIMES_S = np.geomspace(0.03, 300.0, 13)  # three elements a decade


def record(path, peaks_V, seed, per_decade=0.0):
    voltage_V = triangles(peaks_V)
    plays, force_N = np.zeros(THRESHOLDS_V.size), np.empty(voltage_V.size)
    for k, now in enumerate(voltage_V):
        plays = np.clip(plays, now - THRESHOLDS_V, now + THRESHOLDS_V)
        force_N[k] = 70.0 * np.tanh((0.6 * now + WEIGHTS @ plays) / 80.0)
    behind, crept = np.zeros(TIMES_S.size), np.empty(force_N.size)
    nearer = 1.0 - np.exp(-1.0 / (RATE_HZ * TIMES_S))
    for k, now in enumerate(force_N):
        behind += nearer * (now - behind)
        crept[k] = now + per_decade / 3.0 * behind.sum()
    reading_N = crept + np.random.default_rng(seed).normal(0.0, NOISE_N, crept.size)
    columns = np.column_stack((np.arange(crept.size) / RATE_HZ, voltage_V, reading_N))
    np.savetxt(path, columns, "%.6f", ",", header="time_s,voltage_V,force_N", comments="")
    return path


def test_a_creep_of_the_force_is_named_alone_and_its_model_predicts(tmp_path):
    first = record(tmp_path / "first.csv", (100, 40, 80, 60, 100, 30), 1)
    work = record(tmp_path / "work.csv", (90, 50, 100, 70, 35, 90, 20, 60), 2, PER_DECADE)
    later = record(tmp_path / "later.csv", (60, 95, 45, 80, 100, 55), 3, PER_DECADE)
    given = piezod.identify(str(first)).model
    found = piezod.diagnose(str(work), model=given)
    assert [one["name"] for one in found.findings["effects"]] == ["creep"]
    creep = next(entry for entry in found.model.effects if entry.name == "creep")
    assert creep.parameters["driven_by"] == 2.0
    assert creep.parameters["per_decade"] == pytest.approx(PER_DECADE, rel=0.05)
    for path in (work, later):
        measured_N = piezod.read_recording(path).channel("force_N")
        left_N = [
            np.std(measured_N - piezod.simulate(path, model).channel("force_N")) for model in (given, found.model)
        ]
        assert left_N[1] < 0.2 * left_N[0]
