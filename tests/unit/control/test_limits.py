"""The limiter: its promises for any planned voltage."""

from math import inf, nan

from hypothesis import given
from hypothesis import strategies as st

from piezod.config import LimitsConfig
from piezod.control.limits import Limiter

DT_S = 0.001


def limits(**changes):
    values = {
        "voltage_min_V": 0.0,
        "voltage_max_V": 140.0,
        "voltage_step_V": 0.0,
        "slew_V_per_s": 4000.0,
        "current_max_A": 0.06,
        "capacitance_F": 1e-5,
        "force_min_N": -20.0,
        "force_trip_N": 360.0,
        "ramp_down_V_per_s": 400.0,
        "stale_after_ms": 5.0,
        "comm_loss_ms": 200.0,
        "device_watchdog_ms": 100,
    }
    return LimitsConfig(**values | changes)


plans = st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=50)


@given(plans, st.sampled_from([0.0, 0.01, 0.5, 3.0]), st.floats(0, 4))
def test_no_plan_leads_outside_range_or_slew(plans_V, step_V, change_V):
    limiter = Limiter(limits(voltage_step_V=step_V), DT_S)
    for planned_V in plans_V:
        voltage = limiter.limit(planned_V, change_V)
        assert 0.0 <= voltage <= 140.0
        assert abs(voltage - limiter.applied_V) <= min(change_V, 4.0) + 1e-9
        limiter.applied_V = voltage


@given(st.floats(0, 140), st.sampled_from([0.01, 0.1, 0.5]))
def test_a_rounded_voltage_is_the_nearest_step(planned_V, step_V):
    limiter = Limiter(limits(voltage_step_V=step_V, slew_V_per_s=1e6, current_max_A=100.0), 1.0)
    voltage = limiter.limit(planned_V)
    assert abs(voltage / step_V - round(voltage / step_V)) < 1e-9
    assert abs(voltage - planned_V) <= step_V / 2 + 1e-9


def test_a_plan_that_is_not_finite_keeps_the_voltage():
    limiter = Limiter(limits(), DT_S)
    limiter.applied_V = 50.0
    assert limiter.limit(nan) == limiter.limit(inf) == limiter.limit(-inf) == 50.0


@given(plans, st.floats(0.001, 3.0))
def test_a_voltage_never_changes_its_rate_faster_than_the_acceleration(plans_V, step_V):
    limiter = Limiter(limits(acceleration_V_per_s2=step_V / DT_S**2), DT_S)
    before, voltage = 0.0, 0.0
    for planned_V in plans_V:
        change_before, before = voltage - before, voltage
        voltage = limiter.limit(planned_V)
        limiter.acknowledged(voltage)
        assert 0.0 <= voltage <= 140.0
        if 0.0 < voltage < 140.0:  # at the ends of the range, the range limit is stronger
            assert abs(voltage - before - change_before) <= step_V + 1e-9


def test_an_accelerated_voltage_stops_at_the_plan():
    limiter = Limiter(limits(acceleration_V_per_s2=2e5), DT_S)
    path = []
    for _ in range(300):
        limiter.acknowledged(limiter.limit(100.0))
        path.append(limiter.applied_V)
    assert max(path) <= 100.0 + 1e-9
    assert abs(path[-1] - 100.0) < 1e-6


def test_rise_and_fall_have_separate_slew_limits():
    limiter = Limiter(limits(slew_V_per_s=1000.0, slew_down_V_per_s=3000.0), DT_S)
    limiter.applied_V = 50.0
    assert limiter.limit(100.0) == 51.0
    assert limiter.limit(0.0) == 47.0


@given(st.lists(st.tuples(st.floats(0, 140), st.booleans(), st.booleans()), min_size=1, max_size=60))
def test_the_device_sees_no_change_above_the_slew_whichever_unanswered_commands_arrived(commands):
    limiter = Limiter(limits(), DT_S)
    at_device = 0.0
    for planned_V, arrives, answered in commands:
        voltage = limiter.limit(planned_V)
        if arrives or answered:
            assert abs(voltage - at_device) <= 4.0 + 1e-9
            at_device = voltage
        if answered:
            limiter.acknowledged(voltage)
        else:
            limiter.perhaps_sent(voltage)


def test_a_command_early_in_a_tick_may_change_by_its_share_of_the_tick():
    limiter = Limiter(limits(), DT_S)
    assert limiter.limit(100.0, share=0.25) == 1.0


@given(st.floats(0, 140), st.sampled_from([0.0, 0.5]))
def test_a_narrowed_range_is_entered_within_the_slew(start_V, step_V):
    limiter = Limiter(limits(voltage_step_V=step_V), DT_S)
    limiter.applied_V = start_V
    limiter.set_limits(limits(voltage_step_V=step_V, voltage_max_V=60.0))
    for _ in range(50):
        voltage = limiter.limit(140.0)
        assert abs(voltage - limiter.applied_V) <= 4.0 + 1e-9
        limiter.acknowledged(voltage)
    assert limiter.applied_V <= 60.0
