"""Whiteness of a residual as MATLAB's `resid` defines it, against values worked out by hand and by other code."""

import json

import numpy as np
import pytest
from scipy import signal

from piezod.errors import UsageError
from piezod.model import load_model
from piezod.recording import Recording, read_recording
from piezod.report.whiteness import residual_of, whiteness_as_dict, whiteness_test, write_whiteness_page
from tests.unit.report.driven_by_model import MODEL, white, write_measured_and_simulated


def recording(u, dt_s=1e-3, **channels):
    return Recording(np.arange(u.size) * dt_s, {"voltage_V": u, **channels})


def test_a_white_residual_lies_within_the_bounds_as_often_as_they_say():
    outside = 0
    for seed in range(40):
        test = whiteness_test(recording(white(seed)), white(1000 + seed), "voltage_V")
        outside += test.auto_outside + test.cross_outside
    assert 10 <= outside <= 60  # 1 % of 40 * 76 is 30; the chance to lie outside these is under 1e-4


def test_correlations_are_those_of_scipy():
    e, u = white(1), white(2) + 3.0
    test = whiteness_test(recording(u), e, "voltage_V", lags=10)
    e0, u0 = e - e.mean(), u - u.mean()
    full = signal.correlate(e0, u0) / np.sqrt(np.sum(e0**2) * np.sum(u0**2))
    assert test.cross == pytest.approx(full[e.size - 11 : e.size + 10], abs=1e-12)
    full = signal.correlate(e0, e0) / np.sum(e0**2)
    assert test.auto == pytest.approx(full[e.size - 1 : e.size + 10], abs=1e-12)


def test_the_bound_of_the_autocorrelation_is_that_of_99_percent():
    test = whiteness_test(recording(white(1, 10_000)), white(2, 10_000), "voltage_V")
    assert test.auto_bound == pytest.approx(2.58 / 100)


def test_the_bound_with_the_input_is_that_of_ljung():
    e, u = (signal.lfilter([1], [1, -0.9], white(seed)) for seed in (3, 4))
    test = whiteness_test(recording(u), e, "voltage_V")
    r_e, r_u = (np.array([np.sum(x[k:] * x[: x.size - k]) for k in range(26)]) for x in (e - e.mean(), u - u.mean()))
    spread = r_e[0] * r_u[0] + 2 * np.sum(r_e[1:] * r_u[1:])
    assert test.cross_bound == pytest.approx(2.58 * np.sqrt(spread / e.size / (r_e[0] * r_u[0])), rel=1e-9)
    assert test.cross_bound > 2.5 * test.auto_bound


def test_a_residual_that_follows_the_input_has_a_peak_at_the_lag():
    u = white(5)
    test = whiteness_test(recording(u), 0.5 * np.roll(u, 3) + white(6), "voltage_V")
    assert np.argmax(np.abs(test.cross)) - 25 == 3
    assert "correlated with the input" in test.sentence


def test_a_missed_tick_does_not_shift_later_samples():
    u, e = white(7), white(8)
    present = np.ones(u.size, bool)
    present[5000:5007] = False
    whole = whiteness_test(recording(u), np.where(present, e, np.nan), "voltage_V")
    time_s = np.arange(u.size) * 1e-3
    gap = Recording(time_s[present], {"voltage_V": u[present]})
    assert whiteness_test(gap, e[present], "voltage_V").cross == pytest.approx(whole.cross, abs=1e-3)


@pytest.mark.parametrize(
    ("u", "e", "says"),
    [
        (np.zeros(1000), white(1, 1000), "voltage_V is constant"),
        (white(1, 1000), np.ones(1000), "the residual is constant"),
        (white(1, 50), white(2, 50), "50 samples to test, need at least 100"),
    ],
)
def test_constant_or_short_signals_are_refused(u, e, says):
    with pytest.raises(UsageError, match=says):
        whiteness_test(recording(u), e, "voltage_V")


def test_the_residual_of_a_right_model_is_white_and_the_page_says_so(tmp_path):
    measured = read_recording(write_measured_and_simulated(tmp_path)[0])
    residual = residual_of(load_model(MODEL), measured, 1.0)
    assert np.isnan(residual[:200]).all()
    test = whiteness_test(measured, residual, "voltage_V")
    assert test.auto_outside <= 2
    write_whiteness_page(tmp_path / "residual.html", test, measured, residual, "N")
    assert test.sentence in (tmp_path / "residual.html").read_text(encoding="utf-8")
    assert len(json.dumps(whiteness_as_dict(test, measured, "m", "N"))) > 500
