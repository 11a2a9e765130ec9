"""The step response of a bench with a known lag, from records that determine it and from one that does not."""

import numpy as np
import pytest

from piezod.excitation import excitation
from piezod.identify.step_response import BEFORE, step_response

DT_S = 0.005


def lagged(modelled, tau_s, seed=1, noise=0.05):
    """First-order lag, exact for a held input: y += (1 - exp(-dt / tau)) (x - y), with white noise."""
    share = 1.0 - np.exp(-DT_S / tau_s) if tau_s else 1.0
    measured, state = np.empty_like(modelled), modelled[0]
    for k, value in enumerate(modelled):
        state += share * (value - state)
        measured[k] = state
    return measured + noise * np.random.default_rng(seed).standard_normal(modelled.size)


def rich(rate_Hz=1.0 / DT_S):
    return excitation("staircase-minor-loops-multisine", 120.0, 0.1, 1, rate_Hz)


@pytest.mark.parametrize("tau_s", [0.0, 0.012, 0.05])
def test_the_response_of_a_lag_is_that_of_its_definition(tau_s):
    modelled = rich()
    found = step_response(lagged(modelled, tau_s), modelled, DT_S)
    assert found is not None
    assert found.is_shown
    since = np.maximum(found.lag_s + DT_S, 0.0)  # the lag answers within the sample of the step
    expected = 1.0 - np.exp(-since / tau_s) if tau_s else (found.lag_s > -0.5 * DT_S).astype(float)
    assert (np.abs(found.response - expected) < 2.0 * found.band).all()
    assert (np.abs(found.response - expected)[:BEFORE] < 0.15).all()
    if not tau_s:
        assert found.rise_s is None
    else:
        assert found.rise_s is not None
        assert abs(found.rise_s + DT_S - 2.303 * tau_s) < 0.3 * tau_s + DT_S  # ln 10 = 2.303


def test_a_hum_hardly_widens_the_band():
    modelled = rich()
    clean = lagged(modelled, 0.012)
    hum = 0.7 * np.sin(2.0 * np.pi * 50.0 * DT_S * np.arange(modelled.size))
    bands = [step_response(measured, modelled, DT_S).band.max() for measured in (clean, clean + hum)]
    assert bands[1] < 1.5 * bands[0]


def test_slow_triangles_do_not_show_a_response():
    modelled = excitation("varying-triangles", 120.0, 0.1, 5, 1.0 / DT_S)
    found = step_response(lagged(modelled, 0.012), modelled, DT_S)
    assert found is not None
    assert not found.is_shown


def test_a_measurement_ahead_of_the_model_shows_no_response():
    modelled = rich()
    found = step_response(np.roll(lagged(modelled, 0.0), -3), modelled, DT_S)
    assert found is not None
    assert not found.is_shown


def test_missing_samples_change_little_and_short_or_resting_records_have_none():
    modelled = rich()
    measured = lagged(modelled, 0.012)
    whole = step_response(measured, modelled, DT_S)
    measured[1000:1100] = np.nan
    found = step_response(measured, modelled, DT_S)
    np.testing.assert_allclose(found.response, whole.response, atol=0.05)
    assert step_response(measured[:500], modelled[:500], DT_S) is None
    assert step_response(measured, np.zeros_like(modelled), DT_S) is None
