"""The compensator of a model with effects against the forward chain: the simulated force equals the reference."""

import numpy as np
import pytest

from piezod.effects.resonance import invert
from piezod.errors import ModelError
from piezod.model.chain.forward import run_chain
from piezod.model.chain.tick_chain import ticks_late
from piezod.model.extended_compensator import ExtendedCompensator
from tests.unit.model.chains import DT_S, held_model, with_effects

FROM_START = ("rate_dependent_hysteresis", "creep", "electrical_lag", "output_nonlinearity", "voltage_clamp")


@pytest.fixture(scope="module")
def model():
    return held_model()


def reference_N(model, seconds=6.0):
    """Rises smoothly from the force at rest, then moves at several rates with a hold."""
    t = np.arange(0.0, seconds, DT_S)
    span = model.output.high - model.output.low
    rest = float(model.operator().run(np.zeros(1))[0])
    moving = np.where(t < 4.0, t, 4.0)
    shape = 0.35 * (1.0 - np.cos(2.0 * np.pi * 0.5 * moving)) + 0.06 * np.sin(2.0 * np.pi * 7.0 * moving) ** 2
    return t, rest + span * shape


def driven(model, reference, low_V=0.0, high_V=1e3):
    compensator = ExtendedCompensator(model, DT_S)
    voltage_V = np.empty(reference.size)
    for k, value in enumerate(reference):
        voltage_V[k] = min(max(compensator.plan(value), low_V), high_V)
        compensator.commit(voltage_V[k])
    return voltage_V


@pytest.mark.parametrize("name", FROM_START)
def test_the_plan_with_an_effect_gives_the_reference(model, name):
    with_it = with_effects(model, name)
    t, reference = reference_N(model)
    voltage_V = driven(with_it, reference, low_V=-1e3)
    reading = run_chain(with_it, with_it.operator(), t, voltage_V)
    span = model.output.high - model.output.low
    assert np.max(np.abs(reading - reference)) < 1e-8 * span


@pytest.mark.parametrize("swell", [-0.15, 0.4])
def test_a_lag_that_grows_with_the_voltage_is_compensated(model, swell):
    with_it = with_effects(model, "electrical_lag", swell=swell)
    t, reference = reference_N(model)
    voltage_V = driven(with_it, reference, low_V=-1e3)
    span = model.output.high - model.output.low
    assert np.max(np.abs(run_chain(with_it, with_it.operator(), t, voltage_V) - reference)) < 1e-8 * span
    plain = driven(with_effects(model, "electrical_lag"), reference, low_V=-1e3)
    assert np.max(np.abs(run_chain(with_it, with_it.operator(), t, plain) - reference)) > 1e-4 * span


def test_all_effects_at_once_are_compensated_within_the_limits(model):
    with_them = with_effects(model, *FROM_START)
    t, reference = reference_N(model)
    voltage_V = driven(with_them, reference)
    reading = run_chain(with_them, with_them.operator(), t, voltage_V)
    free = (
        (voltage_V > 0.0) & (voltage_V < 140.0) & (t > 0.5)
    )  # the recording begins at rest, the drive slightly above it
    assert np.mean(free) > 0.4
    assert voltage_V.max() > 120.0  # into the knee
    assert np.max(np.abs(reading - reference)[free]) < 1e-6 * (model.output.high - model.output.low)


def test_states_follow_the_applied_voltage_and_not_the_planned_one(model):
    with_them = with_effects(model, "creep", "electrical_lag")
    t, reference = reference_N(model)
    limit_V = 0.6 * driven(with_them, reference).max()
    voltage_V = driven(with_them, reference, high_V=limit_V)
    reading = run_chain(with_them, with_them.operator(), t, voltage_V)
    assert np.any(voltage_V == limit_V)
    free = (voltage_V > 0.0) & (voltage_V < limit_V)
    span = model.output.high - model.output.low
    assert np.max(np.abs(reading - reference)[free]) < 1e-8 * span


def test_a_gap_is_closed_before_a_force_is_applied(model):
    with_it = with_effects(model, "contact_gap", gap_N=20.0, softness_N=2.0)
    t, reference = reference_N(model)
    reference = reference - reference[0] + np.linspace(0.0, 5.0, t.size)
    voltage_V = driven(with_it, reference)
    reading = run_chain(with_it, with_it.operator(), t, voltage_V)
    free = voltage_V > 0.0
    assert np.max(np.abs(reading - reference)[free]) < 1e-6


def test_an_effect_without_an_inverse_is_refused_with_its_reason(model):
    with pytest.raises(ModelError, match=r"friction cannot be compensated: .*; drive without it"):
        ExtendedCompensator(with_effects(model, "friction"), DT_S)


def test_a_delay_and_a_resonance_are_compensated_in_a_reference_known_ahead(model):
    for name, changed in (
        ("transport_delay", {"delay_s": 0.0123}),
        ("resonance", {"frequency_Hz": 60.0, "damping_ratio": 0.05}),
    ):
        with_it = with_effects(model, name, **changed)
        t, reference = reference_N(model)
        planned = ExtendedCompensator(with_it, DT_S).ahead(reference, loop=False)
        reading = run_chain(with_it, with_it.operator(), t, driven(with_it, planned, low_V=-1e3))
        unshaped = run_chain(with_it, with_it.operator(), t, driven(with_it, reference, low_V=-1e3))
        inside = slice(50, -50)
        error, before = (np.sqrt(np.mean((one - reference)[inside] ** 2)) for one in (reading, unshaped))
        assert error < 0.03 * before, name


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.0123, 0.0), (0.0123, 0.0008), (0.0045, 0.004), (0.003, 0.002)])
def test_a_fractional_delay_is_compensated_on_ramps_with_any_lag(delay_s, lag_s):
    """The force within a tick as the lag's own exponential, computed here on a grid of a hundredth of a tick."""
    acting = {"electrical_lag": {"time_constant_s": lag_s}} if lag_s else {}
    ramp = np.arange(200.0)
    ends = np.interp(ramp + ticks_late(delay_s, acting, DT_S), ramp, ramp)
    inside = np.arange(1, 101) / 100.0
    risen = 1.0 - np.exp(-inside * DT_S / lag_s) if lag_s else np.ones(100)
    within = np.concatenate([ends[:1], (ends[:-1, None] + np.diff(ends)[:, None] * risen / risen[-1]).ravel()])
    late = round(100 * delay_s / DT_S)
    assert all(abs(within[100 * k - late] - k) < 1e-9 for k in range(50, 150))


def test_a_reading_one_sample_after_its_command_is_a_delay_of_one_sample(model):
    held = with_effects(model, "creep").model_copy(update={"sampling": "held_before", "sample_s": 5 * DT_S})
    _, reference = reference_N(model)
    planned = ExtendedCompensator(held, DT_S).ahead(reference, loop=False)
    np.testing.assert_allclose(planned[:-5], reference[5:])
    part = held.model_copy(update={"sampling": "held", "read_after": 0.6})
    planned = ExtendedCompensator(part, DT_S).ahead(reference, loop=False)
    np.testing.assert_allclose(planned[:-2], reference[2:])


def test_a_held_command_fitted_as_a_straight_one_is_half_a_sample_later(model):
    """On a ramp the lag delays a straight command by its time constant, a held command by half a sample more."""
    lagged = with_effects(model, "transport_delay", "electrical_lag", delay_s=0.0067, time_constant_s=0.0037)
    fitted = lagged.model_copy(update={"sampling": "straight", "sample_s": DT_S})
    assert ExtendedCompensator(fitted, DT_S).delay_s == pytest.approx(0.0067 + 0.5 * DT_S)


def test_the_inverse_of_a_resonance_against_a_fine_integration():
    """The response of the resonance to the computed force, integrated here in 200 steps per tick."""
    f_Hz, zeta, fine = 40.0, 0.02, 200
    t = np.arange(0.0, 2.0, DT_S)
    wanted = 10.0 * (1.0 - np.cos(2.0 * np.pi * 3.0 * t))
    force = invert(wanted, {"frequency_Hz": f_Hz, "damping_ratio": zeta}, DT_S)
    w, y, speed = 2.0 * np.pi * f_Hz, 0.0, 0.0
    got = np.empty(t.size)
    for k in range(t.size):
        for _ in range(fine):
            speed += DT_S / fine * (w * w * (force[k] - y) - 2.0 * zeta * w * speed)
            y += DT_S / fine * speed
        got[k] = y
    assert np.max(np.abs(got - wanted)[:-5]) < 0.01 * np.ptp(wanted)


def test_the_slope_of_a_creep_refers_to_the_recording_of_its_identification(model):
    """Its weights are proportional to tau^slope about the centre of that recording, for any later drive."""
    with_it = with_effects(model, "creep", slope=0.1, per_decade=0.02).model_copy(update={"seen_s": 20.0})
    t, reference = reference_N(model)
    reading = run_chain(with_it, with_it.operator(), t, driven(with_it, reference, low_V=-1e3))
    assert np.max(np.abs(reading - reference)) < 1e-8 * (model.output.high - model.output.low)
    elsewhere = with_it.model_copy(update={"seen_s": 2000.0})
    other = run_chain(elsewhere, elsewhere.operator(), t, driven(with_it, reference, low_V=-1e3))
    assert np.max(np.abs(other - reference)) > 1e-4 * (model.output.high - model.output.low)


def test_a_creep_that_the_voltage_drives_within_the_tick_is_solved_in_a_second_pass(model):
    """Behind a lag the voltage runs straight through a tick, so that it drives the creep of the same tick."""
    with_it = with_effects(model, "creep", "electrical_lag", driven_by=1.0, from_s=0.002, per_decade=0.05)
    t, reference = reference_N(model)
    reading = run_chain(with_it, with_it.operator(), t, driven(with_it, reference, low_V=-1e3))
    without = driven(with_effects(model, "electrical_lag"), reference, low_V=-1e3)
    before = run_chain(with_it, with_it.operator(), t, without)
    assert np.sqrt(np.mean((reading - reference) ** 2)) < 0.02 * np.sqrt(np.mean((before - reference) ** 2))


def test_thermal_drift_is_compensated_and_an_invalid_temperature_is_ignored(model):
    with_it = with_effects(model, "thermal_drift", coefficient_N_per_K=2.0, lag_s=0.0)
    compensator = ExtendedCompensator(with_it, DT_S)
    cold = compensator.plan(50.0)
    for temperature_C in (20.0, 21.5, np.nan, 900.0):
        compensator.update_temperature(temperature_C)
    assert compensator.plan(50.0 + 2.0 * 1.5) == pytest.approx(cold, rel=1e-12)
