"""Force law, gap, friction, temperature, load, mode and vibration against their closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.recording.hold import Hold

from .records import forward, opening, triangle

HELD = Hold("held", 1e-9)  # read at once after its command

DT_s = 1e-3
shapes = pytest.mark.parametrize(("exponent", "closing"), [(1.0, 1.0), (0.5, 0.3), (1.5, 0.5), (3.0, 0.7), (8.0, 0.5)])


def test_a_curved_law_gains_curvature_times_the_span_at_the_span():
    force = np.array([0.0, 50.0, 100.0])
    changed = forward("output_nonlinearity", force, DT_s, {"curvature": 0.1})
    np.testing.assert_allclose(changed, [0.0, 52.5, 110.0])


@given(curvature=st.floats(-0.8, 0.8), cubic=st.floats(-0.2, 0.2))
def test_the_force_law_rises_everywhere_whatever_its_curvature(curvature, cubic):
    force = np.linspace(-300.0, 300.0, 2001)
    changed = forward("output_nonlinearity", force, DT_s, {"curvature": curvature, "cubic": cubic})
    slope = np.diff(changed) / np.diff(force)
    assert slope.min() >= 0.05 - 1e-9
    assert changed[1000] == 0.0


def test_the_force_is_zero_before_contact_and_smaller_by_the_gap_after_it():
    force = np.array([-5.0, 0.0, 19.0, 20.0, 21.0, 80.0])
    np.testing.assert_allclose(forward("contact_gap", force, DT_s, {"gap_N": 20.0}), [0.0, 0.0, 0.0, 0.0, 1.0, 60.0])


@given(gap=st.floats(0.01, 50.0), softness=st.floats(0.0, 100.0))
def test_a_soft_contact_never_pulls_begins_at_zero_and_ends_on_the_straight_line(gap, softness):
    force = np.linspace(0.0, 120.0, 1201)
    through = forward("contact_gap", force, DT_s, {"gap_N": gap, "softness_N": softness})
    slope = np.diff(through) / np.diff(force)
    assert through[0] == 0.0
    assert slope.min() >= 0.0
    assert slope.max() <= 1.0 + 1e-9
    assert through[-1] == pytest.approx(120.0 - gap)


@shapes
def test_friction_opposes_both_directions_and_widens_a_loop_to_twice_its_force(exponent, closing):
    values = {"force_N": 3.0, "presliding_N": 4.0, "exponent": exponent, "closing": closing}
    for peak, widest in ((1.0, 0.9), (400.0, 6.0)):
        force = triangle(1.0, DT_s, 4, peak=peak)
        behind = forward("friction", force, DT_s, values)
        width = peak * opening(force, behind, 1000)
        assert width <= widest
    assert width > 5.9
    assert (behind[1:500] < force[1:500]).all()
    assert (behind[800:1000] > force[800:1000]).all()


def test_friction_does_not_depend_on_the_rate():
    values = {"force_N": 3.0, "presliding_N": 4.0}
    slow, fast = (forward("friction", triangle(1.0, dt_s, 2, 50.0), dt_s, values) for dt_s in (1e-3, 1e-2))
    np.testing.assert_allclose(slow[::10], fast, atol=1e-9)


def test_the_force_follows_the_temperature_with_its_lag():
    force = np.full(5001, 30.0)
    warmer = np.full(force.size, 22.0)
    warmer[0] = 20.0
    values = {"coefficient_N_per_K": 1.5}
    at_once = forward("thermal_drift", force, DT_s, values, temperature_C=warmer)
    late = forward("thermal_drift", force, DT_s, values | {"lag_s": 2.0}, temperature_C=warmer)
    np.testing.assert_allclose(at_once[1:], 33.0)
    assert late[2000] == pytest.approx(30.0 + 3.0 * (1.0 - np.exp(-1.0)), rel=1e-3)


def test_a_load_steps_on_and_off_and_stays_when_off_s_is_beyond_the_record():
    force = np.zeros(1000)
    values = {"step_N": 5.0, "on_s": 0.2, "off_s": 0.6, "rise_s": 0.02}
    there = forward("load_step", force, DT_s, values)
    np.testing.assert_allclose(there[[200, 210, 220, 600, 610, 620]], [0.0, 2.5, 5.0, 5.0, 2.5, 0.0])
    assert forward("load_step", force, DT_s, values | {"off_s": 1e7})[-1] == 5.0
    assert not forward("load_step", force, DT_s, values | {"off_s": 0.1}).any()


@pytest.mark.parametrize("zeta", [0.01, 0.1, 0.5])
def test_a_mode_overshoots_a_step_by_its_closed_form(zeta):
    step = np.ones(20_000)
    step[0] = 0.0
    output = forward("resonance", step, 1e-5, {"frequency_Hz": 50.0, "damping_ratio": zeta}, hold=HELD)
    assert output.max() - 1.0 == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2)), rel=1e-5)


def test_a_mode_rings_at_its_own_frequency():
    step = np.ones(100_000)
    step[0] = 0.0
    output = forward("resonance", step, 1e-5, {"frequency_Hz": 50.0, "damping_ratio": 0.005}, hold=HELD) - 1.0
    crossings = np.flatnonzero((output[:-1] < 0.0) & (output[1:] >= 0.0))
    assert (crossings.size - 1) / ((crossings[-1] - crossings[0]) * 1e-5) == pytest.approx(50.0, rel=1e-4)


def test_vibration_is_one_line_whose_amplitude_varies():
    force = np.full(10_000, 40.0)
    values = {"amplitude_N": 0.5, "frequency_Hz": 25.0, "phase_rad": 1.0}
    shaken = forward("vibration", force, DT_s, values) - 40.0
    spectrum = 2.0 * np.abs(np.fft.rfft(shaken)) / force.size
    assert spectrum[250] == pytest.approx(0.5)
    assert np.delete(spectrum, 250).max() < 1e-9
    breathing = values | {"breathing_depth": 0.4, "breathing_period_s": 10.0}
    swollen = np.abs(forward("vibration", force, DT_s, breathing) - 40.0)
    assert swollen[2400:2600].max() == pytest.approx(0.7, rel=0.01)
    assert swollen[7400:7600].max() == pytest.approx(0.3, rel=0.01)
