"""The limiter's promises, whatever is asked of it."""

from math import nan

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


wishes = st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=50)


@given(wishes, st.sampled_from([0.0, 0.01, 0.5, 3.0]), st.floats(0, 4))
def test_no_wish_leads_outside_range_or_slew(wished, step_V, change_V):
    limiter = Limiter(limits(voltage_step_V=step_V), DT_S)
    for wish in wished:
        voltage = limiter.limit(wish, change_V)
        assert 0.0 <= voltage <= 140.0
        assert abs(voltage - limiter.applied_V) <= min(change_V, 4.0) + 1e-9
        limiter.applied_V = voltage


@given(st.floats(0, 140), st.sampled_from([0.01, 0.1, 0.5]))
def test_a_voltage_on_the_lattice_is_the_nearest_one(wish, step_V):
    limiter = Limiter(limits(voltage_step_V=step_V, slew_V_per_s=1e6, current_max_A=100.0), 1.0)
    voltage = limiter.limit(wish)
    assert abs(voltage / step_V - round(voltage / step_V)) < 1e-9
    assert abs(voltage - wish) <= step_V / 2 + 1e-9


def test_a_wish_that_is_no_number_leaves_the_voltage_and_is_counted():
    limiter = Limiter(limits(), DT_S)
    limiter.applied_V = 50.0
    assert limiter.limit(nan) == 50.0
    assert limiter.refused == 1
