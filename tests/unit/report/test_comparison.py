"""Fit and residual test as MATLAB defines them, against values worked out by hand and by other code."""

import json

import numpy as np
import pytest
from scipy import signal

from piezod.commissioning.shipped_files import shipped
from piezod.errors import UsageError
from piezod.model import load_model
from piezod.recording import Recording, write_recording
from piezod.report.comparison.output_comparison import compare_files
from piezod.report.comparison.output_page import (
    comparison_as_dict,
    comparison_text,
    residual_as_dict,
    write_comparison_page,
    write_residual_page,
)
from piezod.report.comparison.whiteness import residual_of, residual_test

MODEL = shipped("model.yaml")


def recording(u, dt_s=1e-3, **channels):
    return Recording(np.arange(u.size) * dt_s, {"voltage_V": u, **channels})


def white(seed, size=20_000):
    return np.random.default_rng(seed).standard_normal(size)


def test_a_white_residual_lies_within_the_bounds_as_often_as_they_say():
    outside = 0
    for seed in range(40):
        test = residual_test(recording(white(seed)), white(1000 + seed), "voltage_V")
        outside += test.auto_outside + test.cross_outside
    assert 10 <= outside <= 60  # 1 % of 40 * 76 is 30; the chance to lie outside these is under 1e-4


def test_correlations_are_those_of_scipy():
    e, u = white(1), white(2) + 3.0
    test = residual_test(recording(u), e, "voltage_V", lags=10)
    e0, u0 = e - e.mean(), u - u.mean()
    full = signal.correlate(e0, u0) / np.sqrt(np.sum(e0**2) * np.sum(u0**2))
    assert test.cross == pytest.approx(full[e.size - 11 : e.size + 10], abs=1e-12)
    full = signal.correlate(e0, e0) / np.sum(e0**2)
    assert test.auto == pytest.approx(full[e.size - 1 : e.size + 10], abs=1e-12)


def test_the_bound_of_the_autocorrelation_is_that_of_99_percent():
    test = residual_test(recording(white(1, 10_000)), white(2, 10_000), "voltage_V")
    assert test.auto_bound == pytest.approx(2.58 / 100)


def test_the_bound_with_the_input_is_ljungs():
    e, u = (signal.lfilter([1], [1, -0.9], white(seed)) for seed in (3, 4))
    test = residual_test(recording(u), e, "voltage_V")
    r_e, r_u = (np.array([np.sum(x[k:] * x[: x.size - k]) for k in range(26)]) for x in (e - e.mean(), u - u.mean()))
    spread = r_e[0] * r_u[0] + 2 * np.sum(r_e[1:] * r_u[1:])
    assert test.cross_bound == pytest.approx(2.58 * np.sqrt(spread / e.size / (r_e[0] * r_u[0])), rel=1e-9)
    assert test.cross_bound > 2.5 * test.auto_bound


def test_a_residual_that_follows_the_input_shows_the_lag():
    u = white(5)
    test = residual_test(recording(u), 0.5 * np.roll(u, 3) + white(6), "voltage_V")
    assert np.argmax(np.abs(test.cross)) - 25 == 3
    assert "follows the input" in test.words


def test_a_missed_tick_does_not_shift_what_comes_after_it():
    u, e = white(7), white(8)
    kept = np.ones(u.size, bool)
    kept[5000:5007] = False
    whole = residual_test(recording(u), np.where(kept, e, np.nan), "voltage_V")
    time_s = np.arange(u.size) * 1e-3
    gap = Recording(time_s[kept], {"voltage_V": u[kept]})
    assert residual_test(gap, e[kept], "voltage_V").cross == pytest.approx(whole.cross, abs=1e-3)


@pytest.mark.parametrize(
    ("u", "e", "says"),
    [
        (np.zeros(1000), white(1, 1000), "voltage_V is constant"),
        (white(1, 1000), np.ones(1000), "the residual is constant"),
        (white(1, 50), white(2, 50), "50 samples to test, need at least 100"),
    ],
)
def test_what_tells_nothing_is_refused(u, e, says):
    with pytest.raises(UsageError, match=says):
        residual_test(recording(u), e, "voltage_V")


@pytest.fixture
def files(tmp_path):
    """A measurement of the shipped model with noise, and its simulation from elsewhere at other times."""
    model = load_model(MODEL)
    time_s = np.arange(4000) * 5e-3
    u = 60.0 - 50.0 * np.cos(2 * np.pi * 0.2 * time_s) - 10.0
    operator = model.operator()
    force = operator.run(u)
    noise = 0.5 * white(9, u.size)
    measured, simulated = tmp_path / "measured.csv", tmp_path / "simulated.csv"
    write_recording(Recording(time_s, {"voltage_V": u, "force_N": force + noise}), measured)
    write_recording(Recording(time_s[:3000:2], {"force_N": force[:3000:2] + 1.0}), simulated)
    return measured, simulated, force, noise


def test_the_fit_is_that_of_matlabs_compare(files):
    measured, simulated, force, noise = files
    result = compare_files(measured, [simulated], [MODEL], None, 1.0)
    elsewhere, model = result.candidates
    y = (force + noise)[:2999]
    values = np.interp(np.arange(2999), np.arange(0, 3000, 2), force[:3000:2] + 1.0)
    fit = 100 * (1 - np.linalg.norm(y - values) / np.linalg.norm(y - y.mean()))
    assert elsewhere.agreement.nrmse_percent == pytest.approx(fit, abs=1e-4)
    assert elsewhere.agreement.samples == 2999
    assert model.agreement.rms == pytest.approx(0.5, rel=0.05)
    assert result.best is model
    assert comparison_text(result).splitlines()[-1].startswith("model fits with")
    assert json.loads(json.dumps(comparison_as_dict(result)))["compared"][1]["name"] == "model"


def test_two_files_of_the_same_name_are_told_apart(files, tmp_path):
    measured, simulated, _, _ = files
    twin = tmp_path / "twin" / simulated.name
    twin.parent.mkdir()
    twin.write_bytes(simulated.read_bytes())
    result = compare_files(measured, [simulated, twin], [MODEL], None, 1.0)
    assert [one.name for one in result.candidates] == [str(simulated), str(twin), "model"]


def test_outputs_that_differ_are_not_compared(files):
    with pytest.raises(UsageError, match="outputs differ: displacement_um, force_N"):
        compare_files(files[0], [], [MODEL], "displacement_um", 1.0)
    with pytest.raises(UsageError, match="nothing to compare with"):
        compare_files(files[0], [], [], None, 1.0)


def test_what_a_right_model_leaves_is_white_and_the_pages_say_so(files, tmp_path):
    measured, simulated, _, _ = files
    result = compare_files(measured, [simulated], [MODEL], None, 1.0)
    model = load_model(MODEL)
    left = residual_of(model, result.measured, 1.0)
    assert np.isnan(left[:200]).all()
    test = residual_test(result.measured, left, "voltage_V")
    assert test.auto_outside <= 2
    write_comparison_page(tmp_path / "comparison.html", result)
    write_residual_page(tmp_path / "residual.html", test, result.measured, left, "N")
    assert "model fits with" in (tmp_path / "comparison.html").read_text(encoding="utf-8")
    assert test.words in (tmp_path / "residual.html").read_text(encoding="utf-8")
    assert len(json.dumps(residual_as_dict(test, result.measured, "m", "N"))) > 500
