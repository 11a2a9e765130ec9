"""The supervisor: which readings trip, which faults latch, and which transitions need an operator."""

import pytest

from piezod.control.authority import Demand
from piezod.control.states import Event
from piezod.control.supervisor import Cause, State, Supervisor
from piezod.errors import CheckFailedError
from tests.unit.control.test_limits import limits

MS = 1_000_000


def running(**changes):
    supervisor = Supervisor(limits(**changes))
    supervisor.arm(0)
    supervisor.start_running()
    assert supervisor.state is State.RUNNING
    return supervisor


def test_a_force_above_the_trip_ramps_down_and_latches():
    supervisor = running()
    supervisor.check_reading(360.1, 1)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.OVER_FORCE)
    supervisor.end_ramp_down()
    assert supervisor.state is State.FAULT
    with pytest.raises(CheckFailedError, match="arm: may not come in state FAULT"):
        supervisor.arm(0)
    assert supervisor.state is State.FAULT
    supervisor.reset(at_rest=True)
    assert supervisor.state is State.DISARMED


def test_silence_for_comm_loss_ms_trips_and_a_good_exchange_before_it_does_not():
    supervisor = running()
    supervisor.check_exchange(False, 200 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.check_exchange(True, 200 * MS)
    supervisor.check_exchange(False, 399 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.check_exchange(False, 401 * MS)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.COMM_LOSS)


def test_silence_trips_at_the_tick_nearest_to_comm_loss_ms():
    supervisor = running()
    supervisor.check_exchange(False, 197 * MS, ahead_ns=2 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.check_exchange(False, 199 * MS, ahead_ns=2 * MS)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.COMM_LOSS)


def test_a_device_that_stays_silent_through_the_ramp_ends_in_fault():
    supervisor = running()
    supervisor.check_exchange(False, 201 * MS)
    supervisor.check_exchange(False, 540 * MS)
    assert supervisor.state is State.RAMP_DOWN
    supervisor.check_exchange(False, 560 * MS)
    assert supervisor.state is State.FAULT


def test_comm_loss_action_hold_stops_writing_at_once():
    supervisor = running(comm_loss_action="hold")
    supervisor.check_exchange(False, 201 * MS)
    assert supervisor.state is State.FAULT


def test_comm_loss_action_zero_ramps_as_fast_as_the_slew_allows():
    supervisor = running(comm_loss_action="zero")
    supervisor.check_exchange(False, 201 * MS)
    assert supervisor.state is State.RAMP_DOWN
    assert supervisor.demand is Demand.DANGER


def test_a_stop_ends_disarmed_without_a_fault():
    supervisor = running()
    supervisor.stop()
    supervisor.end_ramp_down()
    assert (supervisor.state, supervisor.fault) == (State.DISARMED, Cause.NONE)


def test_five_ticks_missed_in_a_row_trip():
    supervisor = running()
    supervisor.check_rate(4)
    assert supervisor.state is State.RUNNING
    supervisor.check_rate(5)
    assert supervisor.cause is Cause.MISSED_TICKS


def test_amplifier_fault_bits_and_a_tripped_watchdog_trip():
    for status, cause in (
        (8, Cause.DEVICE_FAULT),
        (16, Cause.DEVICE_TOO_HOT),
        (32, Cause.MAINS_LOST),
        (8 | 16 | 32, Cause.MAINS_LOST),
        (2, Cause.DEVICE_WATCHDOG),
    ):
        supervisor = running()
        supervisor.check_reading(10.0, status)
        assert supervisor.cause is cause
        assert (supervisor.demand is Demand.DANGER) is (cause is not Cause.DEVICE_WATCHDOG)


def test_no_reading_trips_while_no_voltage_is_written():
    supervisor = Supervisor(limits())
    supervisor.check_reading(1000.0, 8)
    supervisor.check_exchange(False, 10_000 * MS)
    assert supervisor.state is State.DISARMED


def test_invalid_readings_trip_once_they_are_stale_and_a_single_one_does_not():
    supervisor = running()
    supervisor.check_exchange(False, 6 * MS, answered=True)
    assert supervisor.state is State.RUNNING
    supervisor.check_exchange(False, 7 * MS, answered=True)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.BAD_READING)


def test_readings_get_stale_and_a_good_one_ends_it():
    supervisor = running()
    supervisor.check_exchange(False, 5 * MS)
    assert not supervisor.readings_stale
    supervisor.check_exchange(False, 6 * MS)
    assert supervisor.readings_stale
    supervisor.check_exchange(True, 7 * MS)
    assert not supervisor.readings_stale
    assert supervisor.state is State.RUNNING


def test_a_device_that_has_taken_over_its_output_gets_no_more_voltages():
    for cause in (Cause.DEVICE_WATCHDOG, Cause.DEVICE_RESTARTED):
        supervisor = running()
        supervisor.trip(cause)
        assert (supervisor.state, supervisor.fault) == (State.FAULT, cause)


def test_a_pause_as_long_as_the_device_watchdog_ends_in_fault_before_a_voltage_is_written():
    supervisor = running()
    supervisor.check_pause(99 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.check_pause(100 * MS)
    assert (supervisor.state, supervisor.cause) == (State.FAULT, Cause.STOOD_STILL)


def test_without_a_device_watchdog_a_pause_longer_than_comm_loss_ramps_down():
    supervisor = running(device_watchdog_ms=0)
    supervisor.check_pause(200 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.check_pause(201 * MS)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.STOOD_STILL)


def test_a_watchdog_that_tripped_before_arming_counts_once_it_was_clear():
    supervisor = Supervisor(limits())
    supervisor.arm(0)
    supervisor.check_reading(0.0, 2)
    assert supervisor.state is State.ARMING
    supervisor.check_reading(0.0, 1)
    supervisor.check_reading(0.0, 2)
    assert supervisor.fault is Cause.DEVICE_WATCHDOG


def test_a_stop_before_the_first_reading_is_no_fault_of_a_watchdog_that_tripped_before_arming():
    supervisor = Supervisor(limits())
    supervisor.arm(0)
    supervisor.stop()
    supervisor.check_reading(0.0, 2)
    assert (supervisor.state, supervisor.fault) == (State.RAMP_DOWN, Cause.NONE)
    supervisor.check_reading(0.0, 1)
    supervisor.check_reading(0.0, 2)
    assert supervisor.fault is Cause.DEVICE_WATCHDOG


@pytest.mark.parametrize("way", ["running", "left output"])
def test_a_watchdog_trips_at_once_where_a_voltage_stands_at_the_output(way):
    supervisor = Supervisor(limits())
    supervisor.arm(0)
    supervisor.check_reading(0.0, 2)
    if way == "running":
        supervisor.start_running()
    else:
        supervisor.stop()
        supervisor.end_ramp_down()
        supervisor.bring_down(1)
    supervisor.check_reading(10.0, 2)
    assert supervisor.fault is Cause.DEVICE_WATCHDOG


def test_a_device_too_hot_trips():
    supervisor = running(temperature_trip_degC=70.0)
    supervisor.check_reading(10.0, 1, 0, 69.9)
    assert supervisor.state is State.RUNNING
    supervisor.check_reading(10.0, 1, 1, 70.1)
    assert supervisor.cause is Cause.TEMPERATURE


def test_the_first_fault_stays_latched():
    supervisor = running()
    supervisor.trip(Cause.OVER_FORCE)
    supervisor.trip(Cause.COMM_LOSS)
    supervisor.end_ramp_down()
    assert supervisor.fault is Cause.OVER_FORCE


def test_new_limits_apply_at_once_and_keep_state_and_fault():
    supervisor = running()
    supervisor.set_limits(limits(force_trip_N=100.0))
    assert supervisor.state is State.RUNNING
    supervisor.check_reading(101.0, 1)
    supervisor.set_limits(limits())
    assert supervisor.fault is Cause.OVER_FORCE


def test_a_fault_without_any_later_valid_reading_ends_latched():
    supervisor = running()
    supervisor.check_exchange(False, 6 * MS, answered=True)
    supervisor.check_exchange(False, 7 * MS, answered=True)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.BAD_READING)
    supervisor.check_exchange(False, 549 * MS, answered=True)
    assert supervisor.state is State.RAMP_DOWN
    supervisor.check_exchange(False, 551 * MS, answered=True)
    assert (supervisor.state, supervisor.cause) == (State.FAULT, Cause.BAD_READING)


def test_an_exchange_may_last_until_the_silence_is_a_loss_and_without_limit_while_no_voltage_is_written():
    supervisor = running()
    supervisor.check_exchange(True, 10 * MS)
    assert supervisor.exchange_time_left_s(150 * MS) == pytest.approx(0.06)
    assert supervisor.exchange_time_left_s(210 * MS - 1) == pytest.approx(1e-9)
    assert supervisor.exchange_time_left_s(210 * MS) == float("inf")  # no time is left: 0 s would forbid every exchange
    assert supervisor.exchange_time_left_s(250 * MS) == float("inf")
    assert Supervisor(limits()).exchange_time_left_s(0) == float("inf")


def test_a_reset_acts_in_the_state_fault_at_rest_and_nowhere_else():
    supervisor = Supervisor(limits())
    for lead, state in (
        (lambda: None, State.DISARMED),
        (lambda: supervisor.arm(0), State.ARMING),
        (supervisor.start_running, State.RUNNING),
        (lambda: supervisor.trip(Cause.OVER_FORCE), State.RAMP_DOWN),
    ):
        lead()
        with pytest.raises(CheckFailedError, match=f"reset: may not come in state {state.name}"):
            supervisor.reset(at_rest=True)
        assert supervisor.state is state
    assert supervisor.fault is Cause.OVER_FORCE
    supervisor.end_ramp_down()
    supervisor.reset(at_rest=False)
    assert (supervisor.state, supervisor.fault) == (State.FAULT, Cause.OVER_FORCE)
    supervisor.reset(at_rest=True)
    assert (supervisor.state, supervisor.fault) == (State.DISARMED, Cause.NONE)


def test_a_stop_ramps_down_from_every_state_that_drives():
    for lead in (
        lambda _: None,
        Supervisor.start_running,
        lambda one: (one.start_running(), one.apply(Event.LAPSED, Cause.REFERENCE_ENDED)),
    ):
        supervisor = Supervisor(limits())
        supervisor.arm(0)
        lead(supervisor)
        assert supervisor.driving
        supervisor.stop()
        assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.STOPPED)


@pytest.mark.parametrize(("right", "trips"), [(1, True), (2, True), (3, False)])
def test_exchanges_that_fail_more_often_than_one_in_four_trip(right, trips):
    supervisor = running(failed_exchanges=10)
    for k in range(200):
        supervisor.check_exchange(k % (right + 1) > 0, k * 1_000_000)
    assert (supervisor.fault is Cause.BAD_EXCHANGES) == trips


@pytest.mark.parametrize(("right", "trips"), [(1, True), (2, True), (3, False)])
def test_ticks_that_are_missed_more_often_than_one_in_four_trip(right, trips):
    supervisor = running(missed_ticks_in_a_row=5)
    for k in range(200):
        supervisor.check_rate(int(k % (right + 1) == 0))
    assert (supervisor.fault is Cause.MISSED_TICKS) == trips
