"""Expected readings against the forward chain, and forces corrected for the load cell."""

import numpy as np
import pytest

from piezod.model.chain.forward import run_chain
from piezod.model.expected import ExpectedReading
from piezod.model.parameters import EffectValues
from tests.unit.model.chains import DT_S, FOUND, held_model, with_effects

LOAD_CELL = ("charge_leakage", "sensor_filter", "feedthrough", "transport_delay")


@pytest.fixture(scope="module")
def model():
    return held_model()


def voltage_V(seconds=4.0):
    """Rest, triangles, a hold, a step and rest again."""
    t = np.arange(0.0, seconds, DT_S)
    return t, np.interp(t, [0, 0.2, 0.7, 1.2, 1.9, 2.6, 2.601, 3.2, seconds], [0, 0, 90, 30, 120, 120, 60, 60, 80])


def forward_N(model, t, u):
    return run_chain(model, model.operator(), t, u)


ALONE = [(name,) for name in FOUND if name not in ("mains_hum", "transport_delay")]


@pytest.mark.parametrize("names", [*ALONE, ("electrical_lag", "resonance"), ("electrical_lag", "sensor_filter")])
def test_the_expected_reading_equals_the_forward_chain(model, names):
    extended = with_effects(model, *names)
    t, u = voltage_V()
    expected, _ = ExpectedReading(extended, DT_S).run(u, np.zeros(t.size))
    span = model.output.high - model.output.low
    assert np.max(np.abs(expected - forward_N(extended, t, u))) < 1e-8 * span


@pytest.mark.parametrize("damping_ratio", [np.sqrt(0.5), np.sqrt(0.75), 1.2])
def test_a_second_order_low_pass_is_expected_and_corrected_at_any_damping(model, damping_ratio):
    extended = with_effects(model, "sensor_filter", order=2.0, damping_ratio=float(damping_ratio))
    t, u = voltage_V()
    read = forward_N(extended, t, u)
    expected, corrected = ExpectedReading(extended, DT_S).run(u, read)
    np.testing.assert_allclose(expected, read, atol=1e-8 * (model.output.high - model.output.low))
    np.testing.assert_allclose(corrected, forward_N(model, t, u), atol=1e-8)


def test_a_second_order_low_pass_without_a_damping_ratio_is_a_butterworth(model):
    alone = EffectValues(name="sensor_filter", parameters={"cutoff_Hz": 20.0, "order": 2.0})
    t, u = voltage_V()
    butterworth = with_effects(model, "sensor_filter", order=2.0, damping_ratio=0.5**0.5)
    read = forward_N(model.model_copy(update={"effects": (alone,)}), t, u)
    np.testing.assert_allclose(read, forward_N(butterworth, t, u), rtol=1e-12)


def test_a_delay_of_whole_ticks_shows_the_earlier_force(model):
    t, u = voltage_V()
    force = forward_N(model, t, u)
    reading = np.concatenate((np.full(7, force[0]), force[:-7])) + 0.1 * np.sin(t)
    expected, corrected = ExpectedReading(with_effects(model, "transport_delay"), DT_S).run(u, reading)
    np.testing.assert_allclose(expected[7:], force[:-7], atol=1e-9)
    np.testing.assert_allclose(corrected, force + 0.1 * np.sin(t), atol=1e-9)


@pytest.mark.parametrize("names", [*((name,) for name in LOAD_CELL), LOAD_CELL])
def test_the_corrected_force_is_the_true_force_with_the_noise_not_amplified(model, names):
    extended = with_effects(model, *names)
    t, u = voltage_V()
    force = forward_N(model, t, u)
    noise = 0.1 * np.random.default_rng(1).standard_normal(t.size)
    reading, _ = ExpectedReading(extended, DT_S).run(u, np.zeros(t.size))
    _, corrected = ExpectedReading(extended, DT_S).run(u, reading + noise)
    assert np.std(reading - force) > 0.5
    np.testing.assert_allclose(corrected - force, noise, atol=1e-8)


def test_a_force_unknown_to_the_model_stays_in_the_corrected_force(model):
    """A load of 5 N stays visible behind a charge amplifier with a leakage of 1000 s."""
    extended = with_effects(model, "charge_leakage", time_constant_s=1000.0)
    t, u = voltage_V()
    load = np.where(t > 1.0, 5.0, 0.0)
    force = forward_N(model, t, u)
    expected, _ = ExpectedReading(extended, DT_S).run(u, np.zeros(t.size))
    _, corrected = ExpectedReading(extended, DT_S).run(u, expected + load)
    np.testing.assert_allclose(corrected, force + load, atol=1e-8)


def test_a_hum_of_other_amplitude_and_phase_is_corrected(model):
    extended = with_effects(model, "mains_hum")
    t, u = voltage_V(12.0)
    force = forward_N(model, t, u)
    hum = forward_N(with_effects(model, "mains_hum", phase_rad=2.2, amplitude_N=3.0), t, u) - force
    _, corrected = ExpectedReading(extended, DT_S).run(u, force + hum)
    settled = t > 8.0
    assert np.std(hum) > 2.0
    assert np.std((corrected - force)[settled]) < 0.02 * np.std(hum)


def test_a_frozen_reading_keeps_its_difference_from_the_model(model):
    t, u = voltage_V()
    force = forward_N(model, t, u)
    noise = 0.1 * np.random.default_rng(2).standard_normal(t.size)
    reading = force + 1.0 + noise
    reading[500:900] = reading[499]
    _, corrected = ExpectedReading(model, DT_S).run(u, reading)
    assert np.abs(reading - force)[500:900].max() > 20.0
    held = corrected[502:900] - force[502:900]
    np.testing.assert_allclose(held, held[0])


def test_pieces_equal_the_whole_and_a_missing_reading_keeps_the_difference(model):
    extended = with_effects(model, "creep", "electrical_lag", "resonance", "sensor_filter", "transport_delay")
    t, u = voltage_V()
    reading = 1.5 + forward_N(model, t, u)
    reading[1000:1100] = np.nan
    whole = ExpectedReading(extended, DT_S).run(u, reading)
    pieces = ExpectedReading(extended, DT_S)
    parts_run = [pieces.run(u[first : first + 333], reading[first : first + 333]) for first in range(0, t.size, 333)]
    for one, parts in zip(whole, zip(*parts_run, strict=True), strict=True):
        np.testing.assert_array_equal(one, np.concatenate(parts))
    assert np.isfinite(whole[1]).all()
    pieces.reset()
    again = pieces.run(u, reading)
    np.testing.assert_array_equal(again[0], whole[0])


def test_an_effect_without_an_inverse_is_not_in_the_expected_reading(model):
    t, u = voltage_V()
    expected, _ = ExpectedReading(with_effects(model, "friction"), DT_S).run(u, np.zeros(t.size))
    np.testing.assert_allclose(expected, forward_N(model, t, u), atol=1e-9)
