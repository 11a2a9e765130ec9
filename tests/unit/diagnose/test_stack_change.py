"""A changed gain is a change of the stack, whatever curves its force law and whatever it did to the start."""

import numpy as np
import pytest

import piezod
from tests.benches.plain_stack import RATE_HZ, triangles

THRESHOLDS_V, WEIGHTS = np.array([5.0, 15.0, 40.0]), np.array([0.2, 0.2, 0.15])
NOISE_N = 0.05


def record(path, peaks_V, seed, *, of_stroke=1.0, of_force=1.0):
    voltage_V = triangles(peaks_V)
    plays, force_N = np.zeros(THRESHOLDS_V.size), np.empty(voltage_V.size)
    for k, now in enumerate(voltage_V):
        plays = np.clip(plays, now - THRESHOLDS_V, now + THRESHOLDS_V)
        force_N[k] = of_force * 70.0 * np.tanh(of_stroke * (0.6 * now + WEIGHTS @ plays) / 80.0)
    reading_N = force_N + np.random.default_rng(seed).normal(0.0, NOISE_N, force_N.size)
    columns = np.column_stack((np.arange(force_N.size) / RATE_HZ, voltage_V, reading_N))
    np.savetxt(path, columns, "%.6f", ",", header="time_s,voltage_V,force_N", comments="")
    return path


@pytest.mark.parametrize("change", [{"of_force": 0.93}, {"of_stroke": 0.93}], ids=["of the force", "of the stroke"])
def test_a_changed_gain_behind_a_curved_law_is_no_effect_of_the_catalogue(tmp_path, change):
    model = piezod.identify(str(record(tmp_path / "first.csv", (100, 40, 80, 60, 100, 30), 1))).model
    work = record(tmp_path / "work.csv", (90, 50, 70, 35, 60, 20), 2, **change)
    found = piezod.diagnose(str(work), model=model)
    assert found.findings["effects"] == []
    base = found.findings["base"]
    assert base["status"] == "changed"
    assert base["gain"]["value"] == pytest.approx(0.93, abs=0.01)
    later = record(tmp_path / "later.csv", (60, 85, 45, 80, 55), 3, **change)
    left_N = piezod.read_recording(later).channel("force_N") - piezod.simulate(later, found.model).channel("force_N")
    assert np.std(left_N) < 1.3 * NOISE_N
