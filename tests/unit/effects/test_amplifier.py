"""Clamp, slew limit and lag against their closed forms."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from piezod.effects.slew_limit import slew_step
from piezod.recording.hold import HELD_BEFORE, Hold

from .records import forward, opening, triangle

HELD = Hold("held", 1e-9)  # read at once after its command

DT_s = 1e-3


def test_a_clamp_leaves_the_voltage_below_and_holds_it_above():
    u = triangle(1.0, DT_s, 2, peak=100.0)
    clamped = forward("voltage_clamp", u, DT_s, {"limit_V": 70.0})
    np.testing.assert_array_equal(clamped, np.minimum(u, 70.0))


def test_the_knee_joins_both_lines_in_value_and_slope_and_lies_a_quarter_knee_below_at_the_limit():
    u = np.linspace(50.0, 90.0, 4001)
    clamped = forward("voltage_clamp", u, DT_s, {"limit_V": 70.0, "knee_V": 4.0})
    slope = np.diff(clamped) / np.diff(u)
    assert np.interp(70.0, u, clamped) == pytest.approx(70.0 - 4.0 / 4.0, abs=1e-6)
    np.testing.assert_allclose(clamped[u <= 66.0], u[u <= 66.0])
    np.testing.assert_allclose(clamped[u >= 74.0], 70.0)
    assert np.abs(np.diff(slope)).max() < 0.01 / 8.0 * 1.01  # 0.01 V of the 8 V in which it falls from 1 to 0


@pytest.mark.parametrize("size_V", [2.0, 20.0, 60.0])
def test_a_step_takes_its_size_divided_by_the_limit(size_V):
    u = np.zeros(1000)
    u[100:] = size_V
    slewed = forward("slew_limit", u, DT_s, {"limit_V_per_s": 100.0}, hold=HELD)
    arrived = np.flatnonzero(slewed >= size_V - 1e-9)[0] * DT_s
    assert arrived - 0.1 == pytest.approx(size_V / 100.0, abs=1.01 * DT_s)


def test_a_rate_below_the_limit_passes_and_a_rate_above_it_becomes_the_limit():
    u = 80.0 * np.arange(500) * DT_s
    np.testing.assert_allclose(forward("slew_limit", u, DT_s, {"limit_V_per_s": 81.0}), u, atol=1e-12)
    np.testing.assert_allclose(forward("slew_limit", u, DT_s, {"limit_V_per_s": 50.0}), u * 50.0 / 80.0, atol=1e-12)


@given(
    y=st.floats(-5.0, 5.0),
    before=st.floats(-5.0, 5.0),
    now=st.floats(-5.0, 5.0),
    most=st.floats(1e-3, 10.0),
)
def test_one_slew_step_equals_a_thousand_small_steps(y, before, now, most):
    parts = 1000
    commands = before + (now - before) * np.arange(parts + 1) / parts
    fine = y
    for a, b in pairwise(commands):
        fine = slew_step(fine, a, b, most / parts)
    assert slew_step(y, before, now, most) == pytest.approx(fine, abs=1e-9)


def test_a_held_command_acts_from_its_sample_on():
    u = np.array([0.0, 0.0, 5.0, 5.0, -5.0])
    slow = {"limit_V_per_s": 1.0 / DT_s}
    np.testing.assert_allclose(forward("slew_limit", u, DT_s, slow, hold=HELD), [0.0, 0.0, 0.0, 1.0, 2.0], atol=1e-8)
    np.testing.assert_allclose(forward("slew_limit", u, DT_s, slow, hold=HELD_BEFORE), [0.0, 0.0, 1.0, 2.0, 1.0])


@pytest.mark.parametrize(("frequency_Hz", "percent"), [(0.1, 0.2), (1.0, 2.0)])
def test_a_lag_of_5_ms_opens_the_loop_by_400_f_tau_percent(frequency_Hz, percent):
    u = triangle(frequency_Hz, DT_s, 3)
    lagged = forward("electrical_lag", u, DT_s, {"time_constant_s": 5e-3})
    assert 100.0 * opening(u, lagged, round(1.0 / (frequency_Hz * DT_s))) == pytest.approx(percent, rel=1e-3)


def test_a_lag_reaches_63_percent_of_a_step_after_its_time_constant():
    u = np.zeros(400)
    u[100:] = 1.0
    lagged = forward("electrical_lag", u, DT_s, {"time_constant_s": 0.05}, hold=HELD)
    assert lagged[150] == pytest.approx(1.0 - np.exp(-1.0), rel=1e-8)


@pytest.mark.parametrize("swell", [-0.15, 0.3, 0.8])
def test_a_lag_whose_capacitance_grows_with_the_voltage_agrees_with_a_fine_solution_of_the_equation(swell):
    u = triangle(2.0, DT_s, 2)
    time_s = DT_s * np.arange(u.size)

    def slope(t, y):
        return (np.interp(t, time_s, u) - y) / (0.02 * (1.0 + swell * (y - 60.0) / 100.0))

    solved = solve_ivp(slope, (0.0, time_s[-1]), [u[0]], t_eval=time_s, max_step=DT_s, rtol=1e-8, atol=1e-8).y[0]
    lagged = forward("electrical_lag", u, DT_s, {"time_constant_s": 0.02, "swell": swell})
    plain = forward("electrical_lag", u, DT_s, {"time_constant_s": 0.02})
    assert np.max(np.abs(lagged - solved)) < 0.02 * np.max(np.abs(plain - solved))
