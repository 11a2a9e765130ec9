"""Rate-dependent thresholds, creep and gain drift against their definitions."""

import numpy as np
import pytest

from piezod.effects import EFFECTS
from piezod.effects.creep import spectrum

from .records import forward, opening, over, triangle

DT_s = 1e-3
RATE = {"growth": 0.08, "reference_V_per_s": 10.0, "rate_way_V": 0.5}


def widening(u, dt_s=DT_s, **changed):
    return EFFECTS["rate_dependent_hysteresis"].widening(over(u, dt_s), RATE | changed)


def test_thresholds_grow_with_the_logarithm_of_the_rate():
    for rate in (1.0, 10.0, 1000.0):
        factor, offset = widening(rate * np.arange(500) * DT_s, rate_way_V=0.02)
        assert factor[0] == 1.0
        assert factor[-1] == pytest.approx(1.0 + 0.08 * np.log(1.0 + rate / 10.0), rel=1e-9)
        assert not offset.any()


def test_thresholds_grow_with_a_power_of_the_rate_or_by_an_offset_when_kind_selects_it():
    u = 40.0 * np.arange(501) * DT_s
    factor, offset = widening(u, kind=1.0)
    assert factor[-1] == pytest.approx(5.0**0.08, rel=1e-9)
    assert not offset.any()
    factor, offset = widening(u, kind=2.0)
    assert (factor == 1.0).all()
    assert offset[-1] == pytest.approx(0.08 * 0.1 * 100.0 * np.log(5.0), rel=1e-9)  # of the range of the model, 100 V


@pytest.mark.parametrize("kind", [0.0, 1.0, 2.0])
def test_thresholds_do_not_move_while_the_voltage_rests(kind):
    ramp = 40.0 * np.arange(201) * DT_s
    u = np.concatenate([ramp, np.full(2000, ramp[-1]), ramp[-1] + ramp])
    for result in widening(u, kind=kind):
        assert (result[200:2201] == result[200]).all()
        assert np.abs(np.diff(result[2200:])).max() <= np.abs(np.diff(result[:201])).max()


def test_the_rate_of_a_command_held_for_ten_samples_is_the_rate_of_the_ramp():
    ramp = 40.0 * np.arange(3000) * DT_s / 10
    held = ramp[np.arange(3000) // 10 * 10]
    factor, _ = widening(held, dt_s=DT_s / 10)
    assert factor[-1] == pytest.approx(1.0 + 0.08 * np.log(5.0), rel=1e-6)


@pytest.mark.parametrize("rate_way_V", [0.9, 4.5])
def test_the_rate_reaches_63_percent_after_its_distance(rate_way_V):
    factor, _ = widening(90.0 * np.arange(500) * DT_s, rate_way_V=rate_way_V)
    rate = 10.0 * np.expm1((factor - 1.0) / 0.08)
    assert rate[round(rate_way_V / (90.0 * DT_s))] == pytest.approx(90.0 * (1.0 - np.exp(-1.0)), rel=1e-9)


@pytest.mark.parametrize(("from_s", "to_s"), [(0.1, 1000.0), (1e-3, 1e5), (10.0, 31.0), (1.0, 1.0)])
def test_the_step_response_rises_by_one_a_decade_between_its_ends(from_s, to_s):
    tau_s, weights = spectrum(from_s, to_s)
    to_s = max(to_s, 3.0 * from_s)
    assert tau_s[[0, -1]] == pytest.approx([from_s, to_s])
    assert (weights > 0.0).all()
    rise = weights @ np.exp(-from_s / tau_s) - weights @ np.exp(-to_s / tau_s)
    assert rise == pytest.approx(np.log10(to_s / from_s), rel=1e-12)


@pytest.mark.parametrize("slope", [-0.1, 0.1])
def test_a_tilted_spectrum_rises_by_one_a_decade_in_the_middle_of_the_time_span_that_a_record_shows(slope):
    tau_s, weights = spectrum(1e-2, 1e5, slope, seen_s=100.0)
    at_s = np.array([0.5, 2.0])  # about 1 s, the middle of 10 ms to 100 s
    response = (1.0 - np.exp(-at_s[:, None] / tau_s)) @ weights
    assert (response[1] - response[0]) / np.log10(4.0) == pytest.approx(1.0, rel=0.1)


def test_a_flat_spectrum_rises_evenly_up_to_its_ends():
    tau_s, weights = spectrum(0.1, 1000.0)
    t = np.geomspace(0.1, 1000.0, 401)
    slope = np.gradient(-np.exp(-t[:, None] / tau_s) @ weights, np.log10(t))
    assert np.abs(slope[(t > 0.3) & (t < 300.0)] - 1.0).max() < 0.04
    assert slope.min() > 0.8


def test_a_spectrum_with_a_slope_creeps_faster_at_that_end():
    t = np.geomspace(1.0, 100.0, 201)
    tau_s, weights = spectrum(0.1, 1000.0, 0.3)
    slope = np.gradient(-np.exp(-t[:, None] / tau_s) @ weights, np.log10(t))
    assert slope[-1] / slope[0] == pytest.approx(100.0**0.3, rel=0.05)


def test_creep_in_a_hold_is_per_decade_of_the_step_straight_in_log_time():
    dt_s = 5e-3
    u = np.full(24_001, 50.0)
    u[0] = 10.0
    values = {"per_decade": 0.015, "from_s": 0.1, "to_s": 1000.0}
    held = forward("creep", u, dt_s, values)
    at = np.round(np.array([1.0, 10.0, 100.0]) / dt_s).astype(int)
    np.testing.assert_allclose(np.diff(held[at]) / 40.0, 0.015, rtol=0.01)


def test_the_older_creep_continues_after_a_reversal():
    u = np.concatenate([[0.0], np.full(10_000, 50.0), np.full(200, 49.9)])
    crept = forward("creep", u, 0.01, {"per_decade": 0.02, "from_s": 0.1, "to_s": 1000.0}) - u
    assert crept[-1] > crept[10_001]


def test_creep_opens_a_loop_equally_at_every_frequency_inside_its_time_span():
    values = {"per_decade": 0.015, "from_s": 1e-3, "to_s": 1e5}
    openings = []
    for frequency_Hz in (0.1, 0.3, 1.0):
        u = triangle(frequency_Hz, 1e-3 / frequency_Hz, 100)
        openings.append(100.0 * opening(u, forward("creep", u, 1e-3 / frequency_Hz, values), 1000))
    # the response log10(t) opens a triangle by 0.5065 per decade (derived here): 0.76 % at 1.5 %; the chain ripples
    np.testing.assert_allclose(openings, 0.77, atol=0.02)


def test_creep_driven_by_the_voltage_is_scaled_by_the_weights_of_the_plays():
    rng = np.random.default_rng(1)
    u = np.cumsum(rng.normal(size=500))
    values = {"per_decade": 0.02, "from_s": 0.01, "to_s": 10.0}
    by_plays = forward("creep", 0.6 * u, DT_s, values)
    by_voltage = forward("creep", 0.6 * u, DT_s, values | {"driven_by": 1.0}, applied_V=u, stroke_per_V=0.6)
    np.testing.assert_allclose(by_voltage, by_plays, atol=1e-12)


@pytest.mark.parametrize(("bend", "half_way"), [(0.0, 0.5), (3.0, 0.81757), (-3.0, 1.0 - 0.81757)])
def test_the_gain_has_changed_by_relative_change_at_the_end(bend, half_way):
    x = np.full(1001, 20.0)
    drifted = forward("gain_drift", x, DT_s, {"relative_change": -0.1, "bend": bend}, duration_s=1.0)
    assert drifted[0] == 20.0
    assert drifted[500] == pytest.approx(20.0 * (1.0 - 0.1 * half_way), rel=1e-6)
    assert drifted[-1] == pytest.approx(18.0, rel=1e-12)


@pytest.mark.parametrize(("s_shape", "after_a_tenth"), [(1.0, 0.00645), (0.5, 0.05323), (-1.0, 0.19355)])
def test_an_s_shape_makes_the_drift_start_and_end_slowly(s_shape, after_a_tenth):
    """Expected: p - s sin(2 pi p) / (2 pi), computed by hand; symmetrical about the middle."""
    x = np.full(1001, 20.0)
    values = {"relative_change": -0.1, "bend": 0.0, "s_shape": s_shape}
    share = (forward("gain_drift", x, DT_s, values, duration_s=1.0) / 20.0 - 1.0) / -0.1
    assert share[[0, 100, 500, 900, 1000]] == pytest.approx(
        [0.0, after_a_tenth, 0.5, 1.0 - after_a_tenth, 1.0], abs=1e-5
    )
    assert np.all(np.diff(share) >= -1e-12)
