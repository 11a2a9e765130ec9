"""Each interlock: which readings trip it, and which must not."""

from math import inf, nan, nextafter, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.control.heat_interlock import HeatInterlock
from piezod.control.interlocks import (
    DeviceInterlock,
    ForceInterlock,
    ReadbackInterlock,
    StuckInterlock,
    TemperatureInterlock,
    TrackingInterlock,
)
from piezod.control.states import Cause
from tests.unit.control.test_limits import limits

MS = 1_000_000


def check_all(interlock, forces_N):
    return [interlock.check(force_N, k * MS) for k, force_N in enumerate(forces_N)]


def test_a_single_spike_is_counted_and_trips_nothing():
    interlock = ForceInterlock(limits(force_debounce_samples=2, force_rate_trip_N_per_s=1e4))
    rest = [10.0] * 3
    causes = check_all(interlock, [*rest, 900.0, *rest, -300.0, *rest, 45.0, *rest])
    assert set(causes) == {Cause.NONE}
    assert interlock.spikes == 3


def test_the_first_sample_outside_a_limit_is_suspect_and_the_second_trips():
    interlock = ForceInterlock(limits(force_debounce_samples=2))
    assert interlock.check(360.1, 0) is Cause.NONE
    assert interlock.suspect
    assert interlock.check(360.2, MS) is Cause.OVER_FORCE


@pytest.mark.parametrize(("force_N", "cause"), [(361.0, Cause.OVER_FORCE), (-21.0, Cause.UNDER_FORCE)])
def test_absolute_limits_trip_for_any_earlier_samples(force_N, cause):
    slowly = np.linspace(0.0, force_N, 500)
    assert check_all(ForceInterlock(limits()), slowly)[-1] is cause


@pytest.mark.parametrize(("force_N", "beyond"), [(360.0, Cause.OVER_FORCE), (-20.0, Cause.UNDER_FORCE)])
def test_a_force_at_its_limit_is_permitted_and_the_next_number_beyond_it_is_not(force_N, beyond):
    at_limit = limits(force_trip_N=360.0, force_min_N=-20.0, force_debounce_samples=1)
    assert ForceInterlock(at_limit).check(force_N, 0) is Cause.NONE
    assert ForceInterlock(at_limit).check(nextafter(force_N, 2.0 * force_N), 0) is beyond


def test_an_offset_jump_trips_although_the_force_is_constant_afterwards():
    interlock = ForceInterlock(limits(force_debounce_samples=3, force_rate_trip_N_per_s=1e4))
    assert check_all(interlock, [50.0, 50.0, 150.0, 150.0])[-1] is Cause.NONE
    assert interlock.check(150.0, 4 * MS) is Cause.FORCE_RATE


def test_a_pause_between_two_samples_allows_a_larger_change():
    interlock = ForceInterlock(limits(force_rate_trip_N_per_s=1e4))
    interlock.check(0.0, 0)
    assert interlock.check(90.0, 10 * MS) is Cause.NONE


@given(st.lists(st.floats(-20, 360), min_size=2, max_size=50))
def test_without_a_rate_limit_no_force_inside_the_limits_trips(forces_N):
    assert set(check_all(ForceInterlock(limits()), forces_N)) == {Cause.NONE}


def stuck(samples, travel_V=5.0):
    return StuckInterlock(limits(stuck_samples=samples, stuck_travel_V=travel_V))


def test_equal_readings_while_the_voltage_moves_are_a_stuck_sensor():
    interlock = stuck(10)
    causes = [interlock.check(42.0, k + 1, float(k)) for k in range(10)]
    assert causes[-1] is Cause.SENSOR_STUCK
    assert set(causes[:-1]) == {Cause.NONE}


def test_equal_readings_at_rest_are_no_stuck_sensor():
    interlock = stuck(10)
    assert {interlock.check(42.0, k + 1, 30.0) for k in range(100)} == {Cause.NONE}


def test_the_same_sample_read_again_is_not_counted():
    interlock = stuck(10)
    assert {interlock.check(42.0, 7, float(k)) for k in range(100)} == {Cause.NONE}


def test_a_reading_that_flickers_is_not_stuck():
    interlock = stuck(10)
    assert {interlock.check(42.0 + 0.1 * (k % 9 == 0), k + 1, float(k)) for k in range(100)} == {Cause.NONE}


def readback(**changes):
    return ReadbackInterlock(limits(readback_trip_V=2.0, readback_trip_ms=20.0, **changes))


@given(st.integers(0, 15), st.integers(0, 2**31))
def test_an_output_that_follows_within_the_time_never_trips(lag, seed):
    commands = np.cumsum(np.random.default_rng(seed).uniform(-4.0, 4.0, 300))
    interlock = readback()
    for k, command in enumerate(commands):
        assert interlock.check(commands[max(0, k - lag)], command, k * MS) is Cause.NONE


def test_an_output_that_does_not_follow_trips_after_the_time():
    interlock = readback()
    causes = [interlock.check(0.0, min(0.5 * k, 60.0), k * MS) for k in range(80)]
    first = next(k for k, cause in enumerate(causes) if cause is Cause.READBACK)
    assert 20 < first <= 46  # 2 V are left after 4 ms; then one to two times 20 ms


def test_a_second_master_is_noticed_with_its_second_sample():
    interlock = readback()
    for k in range(100):
        assert interlock.check(50.0, 50.0, k * MS) is Cause.NONE
    assert interlock.check(20.0, 50.0, 100 * MS) is Cause.NONE
    assert interlock.check(20.0, 50.0, 101 * MS) is Cause.READBACK


def test_a_device_without_readback_never_trips_the_readback_interlock():
    interlock = readback()
    assert {interlock.check(nan, 0.5 * k, k * MS) for k in range(200)} == {Cause.NONE}


def tracking():
    return TrackingInterlock(limits(tracking_trip_N=30.0, tracking_trip_ms=10.0))


def test_a_force_far_from_its_reference_trips_after_the_time():
    interlock = tracking()
    causes = [interlock.check(100.0, 150.0, k * MS) for k in range(13)]
    assert causes.index(Cause.TRACKING) == 11  # compared from the second sample on, then 10 ms


def test_a_force_is_compared_with_the_reference_of_the_exchange_before():
    interlock = tracking()
    references = [0.0, 100.0] * 50
    for k in range(1, 100):
        assert interlock.check(references[k - 1], references[k], k * MS) is Cause.NONE


def test_a_limited_voltage_is_not_compared_with_its_reference():
    interlock = tracking()
    assert {interlock.check(0.0, nan, k * MS) for k in range(100)} == {Cause.NONE}


def heat(**changes):
    values = {"dissipation_max_W": 1.0, "loss_tangent": 0.02, "dissipation_over_s": 2.0}
    return HeatInterlock(limits(**values | changes), 0.001)


@pytest.mark.parametrize("shape", [np.sin, lambda x: 2 / pi * np.arcsin(np.sin(x))])
def test_the_power_of_a_full_cycle_is_pi_f_c_tan_delta_vpp_squared(shape):
    interlock = heat(dissipation_max_W=1e4)
    frequency_Hz, amplitude_V = 25.0, 50.0  # forty ticks a period, with one on each peak
    time_s = np.arange(20_000) * 0.001
    for voltage_V in 70.0 + amplitude_V * shape(2 * pi * frequency_Hz * time_s):
        interlock.check(float(voltage_V))
    expected_W = pi * frequency_Hz * 1e-5 * 0.02 * (2 * amplitude_V) ** 2
    assert interlock.power_W == pytest.approx(expected_W, rel=0.03)


def test_ripple_is_not_counted_as_reversals():
    smooth, rippled = heat(dissipation_max_W=1e4), heat(dissipation_max_W=1e4)
    for k in range(4000):
        voltage_V = 140.0 * abs((k / 1000.0) % 2.0 - 1.0)
        smooth.check(voltage_V)
        rippled.check(voltage_V + 0.5 * (k % 2))
    assert rippled.power_W == pytest.approx(smooth.power_W, rel=0.05)


def test_more_heat_than_permitted_trips_and_the_heat_outlasts_the_drive():
    interlock = heat()
    causes = [interlock.check(140.0 * (k // 4 % 2)) for k in range(4000)]
    assert causes[-1] is Cause.OVERHEATED
    assert interlock.check(0.0) is Cause.OVERHEATED


def test_the_permitted_power_itself_does_not_trip():
    voltages_V = [140.0 * (k // 4 % 2) for k in range(400)]
    interlock = heat(dissipation_max_W=1e4)
    most_W = max((interlock.check(voltage_V), interlock.power_W)[1] for voltage_V in voltages_V)
    at_limit, below = heat(dissipation_max_W=most_W), heat(dissipation_max_W=most_W * (1.0 - 1e-12))
    assert {at_limit.check(voltage_V) for voltage_V in voltages_V} == {Cause.NONE}
    assert Cause.OVERHEATED in {below.check(voltage_V) for voltage_V in voltages_V}


def test_an_interlock_without_a_limit_never_trips():
    values = {"tracking_trip_N": None, "readback_trip_V": None, "stuck_samples": None, "dissipation_max_W": None}
    without = limits(**values)
    assert {StuckInterlock(without).check(1.0, k, 10.0 * k) for k in range(50)} == {Cause.NONE}
    readback_without, tracking_without = ReadbackInterlock(without), TrackingInterlock(without)
    for k in range(100):
        assert readback_without.check(1000.0, 0.0, k * MS) is Cause.NONE
        assert tracking_without.check(1000.0, 0.0, k * MS) is Cause.NONE
    assert HeatInterlock(without, 0.001).check(inf) is Cause.NONE


def test_new_limits_keep_heat_reversal_and_trip():
    interlock, undisturbed = heat(), heat()
    causes = []
    tighter = limits(dissipation_max_W=0.9, loss_tangent=0.02, dissipation_over_s=2.0)
    for k in range(4000):
        voltage_V = 140.0 * (k // 4 % 2)
        undisturbed.check(voltage_V)
        causes.append(interlock.check(voltage_V))
        if k % 10 == 9:
            interlock.set_limits(tighter)
    assert interlock.power_W == pytest.approx(undisturbed.power_W)
    assert causes[-1] is Cause.OVERHEATED


def test_new_limits_keep_the_debounce_the_spikes_and_the_last_force():
    changes = {"force_debounce_samples": 3, "force_rate_trip_N_per_s": 1e4}
    interlock = ForceInterlock(limits(**changes))
    check_all(interlock, [10.0, 900.0, 10.0, 900.0, 900.0])
    interlock.set_limits(limits(**changes, force_trip_N=350.0))
    assert (interlock.spikes, interlock.suspect) == (1, True)
    assert interlock.check(900.0, 5 * MS) is Cause.OVER_FORCE
    jumping = ForceInterlock(limits(force_rate_trip_N_per_s=1e4))
    jumping.check(10.0, 0)
    jumping.set_limits(limits(force_rate_trip_N_per_s=9e3))
    assert jumping.check(100.0, MS) is Cause.FORCE_RATE


def test_new_limits_keep_the_count_of_equal_readings_and_their_travel():
    interlock = stuck(10)
    causes = []
    for k in range(10):
        causes.append(interlock.check(42.0, k + 1, float(k)))
        interlock.set_limits(limits(stuck_samples=10, stuck_travel_V=5.0))
    assert causes[-1] is Cause.SENSOR_STUCK


def test_new_limits_keep_the_time_of_a_tracking_error_and_the_readback_outside_its_band():
    interlock = tracking()
    causes = []
    for k in range(13):
        causes.append(interlock.check(100.0, 150.0, k * MS))
        interlock.set_limits(limits(tracking_trip_N=29.0, tracking_trip_ms=10.0))
    assert causes.index(Cause.TRACKING) == 11
    output = readback()
    output.check(50.0, 50.0, 0)
    output.check(20.0, 50.0, MS)
    output.set_limits(limits(readback_trip_V=1.9, readback_trip_ms=20.0))
    assert output.check(20.0, 50.0, 2 * MS) is Cause.READBACK


@pytest.mark.parametrize("debounce", [1, 2, 5])
@pytest.mark.parametrize(("right", "trips"), [(0, True), (1, True), (2, True), (3, False), (4, False)])
def test_forces_that_are_wrong_more_often_than_one_in_four_trip_whatever_the_debounce(debounce, right, trips):
    interlock = ForceInterlock(limits(force_debounce_samples=debounce))
    causes = check_all(interlock, [361.0, *[100.0] * right] * 200)
    assert (Cause.OVER_FORCE in causes) == (trips or debounce == 1)


@pytest.mark.parametrize(("right", "trips"), [(1, True), (2, True), (3, False)])
def test_a_readback_that_is_wrong_more_often_than_one_in_four_trips(right, trips):
    interlock = ReadbackInterlock(limits(readback_trip_V=3.0))
    causes = [interlock.check(voltage_V, 50.0, k * MS) for k, voltage_V in enumerate([90.0, *[50.0] * right] * 100)]
    assert (Cause.READBACK in causes) == trips


@pytest.mark.parametrize(("right", "trips"), [(0, True), (1, True), (2, True), (3, False)])
def test_a_tracking_error_in_more_than_a_quarter_of_the_time_trips(right, trips):
    interlock = TrackingInterlock(limits(tracking_trip_N=10.0, tracking_trip_ms=20.0))
    causes = [interlock.check(force_N, 100.0, k * MS) for k, force_N in enumerate([50.0, *[100.0] * right] * 200)]
    assert (Cause.TRACKING in causes) == trips


def test_an_output_that_the_device_switches_off_trips_at_the_second_sample():
    interlock = DeviceInterlock(limits(output_on_in_status=True))
    assert [interlock.check(status, k * MS) for k, status in enumerate([0, 0, 1, 0, 0])] == [
        *[Cause.NONE] * 4, Cause.OUTPUT_OFF,
    ]  # fmt: skip


def test_a_device_without_the_bit_of_its_output_trips_nothing():
    interlock = DeviceInterlock(limits(output_on_in_status=False))
    assert {interlock.check(status, 0) for status in [1, 0, 0, 0]} == {Cause.NONE}


@pytest.mark.parametrize(("lasts_ms", "cause"), [(99, Cause.NONE), (100, Cause.CLAMPED)])
def test_a_clamped_output_trips_after_its_time(lasts_ms, cause):
    interlock = DeviceInterlock(limits(clamped_trip_ms=100.0))
    assert interlock.check(4, 0) is Cause.NONE
    assert interlock.check(4, lasts_ms * MS) is cause


@pytest.mark.parametrize("strange_C", [-242.0, nan, -40.1])
def test_a_temperature_that_no_bench_has_trips(strange_C):
    interlock = TemperatureInterlock(limits(temperature_trip_degC=70.0))
    causes = [interlock.check(strange_C, k * MS) for k in range(20)]
    assert causes.index(Cause.TEMPERATURE_SENSOR) == 9


def test_a_temperature_that_alternates_with_an_impossible_one_trips():
    interlock = TemperatureInterlock(limits(temperature_trip_degC=70.0))
    assert Cause.TEMPERATURE_SENSOR in [interlock.check(value, 0) for value in [25.0, -242.0] * 30]


def test_without_a_limit_no_temperature_trips():
    interlock = TemperatureInterlock(limits(temperature_trip_degC=None))
    assert {interlock.check(value, 0) for value in [25.0, -242.0, nan] * 30} == {Cause.NONE}


@pytest.mark.parametrize(("frozen_s", "cause"), [(10.0, Cause.TEMPERATURE_SENSOR), (None, Cause.NONE)])
def test_a_temperature_that_never_changes_is_that_of_a_broken_sensor(frozen_s, cause):
    interlock = TemperatureInterlock(limits(temperature_trip_degC=70.0, temperature_frozen_s=frozen_s))
    assert interlock.check(25.0, 0) is Cause.NONE
    assert interlock.check(25.0, 9_900 * MS) is Cause.NONE
    assert interlock.check(25.0, 10_000 * MS) is cause
