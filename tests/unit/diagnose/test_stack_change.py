"""A changed gain is a change of the stack, whatever curves its force law and whatever it did to the start."""

import numpy as np
import pytest

import piezod
from piezod.diagnose.hypothesis.stack_change import StackFactors
from piezod.diagnose.verdict.extended import scaled_hysteresis
from piezod.model.parameters import Hysteresis, Superposition
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


def test_a_hysteresis_is_scaled_as_its_factors_say():
    """Plays, then one-sided dead zones of the stroke, written out; a loop factor leaves the sum of the weights."""
    given = Hysteresis(
        plays=Superposition(thresholds=(0.0, *THRESHOLDS_V), weights=(0.6, *WEIGHTS)),
        dead_zones=Superposition(thresholds=(0.0, 20.0, 50.0), weights=(1.5, 0.3, -0.2)),
        offset=2.0,
    )
    stroke, loops, force = 0.9, 1.2, 1.1
    drive_V = triangles([100, 30, 70])
    plays, expected_N = np.zeros(THRESHOLDS_V.size), np.empty(drive_V.size)
    for k, now in enumerate(drive_V):
        plays = np.clip(plays, now - THRESHOLDS_V, now + THRESHOLDS_V)
        stroke_V = stroke * ((0.6 + WEIGHTS.sum()) * now + loops * WEIGHTS @ (plays - now))
        bends = 0.3 * max(stroke_V - 20.0, 0.0) - 0.2 * max(stroke_V - 50.0, 0.0)
        expected_N[k] = force * (2.0 + 1.5 * stroke_V + bends)
    scaled = scaled_hysteresis(given, StackFactors(stroke, loops, force))
    np.testing.assert_allclose(scaled.operator().run(drive_V), expected_N, rtol=0.0, atol=1e-9)
