"""The state machine: what trips, what latches, what never happens by itself."""

from unit.control.test_limits import limits

from piezod.control.safety import Cause, State, Supervisor

MS = 1_000_000


def running(**changes):
    supervisor = Supervisor(limits(**changes))
    supervisor.arm(0)
    supervisor.reached()
    assert supervisor.state is State.RUNNING
    return supervisor


def test_a_force_above_the_trip_ramps_down_and_latches():
    supervisor = running()
    supervisor.judge_reading(360.1, 1)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.OVER_FORCE)
    supervisor.safe()
    assert supervisor.state is State.FAULT
    supervisor.arm(0)
    assert supervisor.state is State.FAULT
    supervisor.reset()
    assert supervisor.state is State.DISARMED


def test_silence_for_comm_loss_ms_trips_and_a_good_exchange_before_it_does_not():
    supervisor = running()
    supervisor.judge_exchange(False, 200 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.judge_exchange(True, 200 * MS)
    supervisor.judge_exchange(False, 399 * MS)
    assert supervisor.state is State.RUNNING
    supervisor.judge_exchange(False, 401 * MS)
    assert (supervisor.state, supervisor.cause) == (State.RAMP_DOWN, Cause.COMM_LOSS)


def test_a_device_that_stays_silent_through_the_ramp_ends_in_fault():
    supervisor = running()
    supervisor.judge_exchange(False, 201 * MS)
    supervisor.judge_exchange(False, 540 * MS)
    assert supervisor.state is State.RAMP_DOWN
    supervisor.judge_exchange(False, 560 * MS)
    assert supervisor.state is State.FAULT


def test_comm_loss_action_hold_stops_writing_at_once():
    supervisor = running(comm_loss_action="hold")
    supervisor.judge_exchange(False, 201 * MS)
    assert supervisor.state is State.FAULT


def test_comm_loss_action_zero_goes_as_fast_as_the_slew_allows():
    supervisor = running(comm_loss_action="zero")
    supervisor.judge_exchange(False, 201 * MS)
    assert supervisor.state is State.RAMP_DOWN
    assert supervisor.in_haste


def test_a_stop_ends_disarmed_without_a_fault():
    supervisor = running()
    supervisor.stop()
    supervisor.safe()
    assert (supervisor.state, supervisor.fault) == (State.DISARMED, Cause.NONE)


def test_five_ticks_missed_in_a_row_trip():
    supervisor = running()
    supervisor.judge_clock(4)
    assert supervisor.state is State.RUNNING
    supervisor.judge_clock(5)
    assert supervisor.cause is Cause.MISSED_TICKS


def test_amplifier_fault_bits_and_a_tripped_watchdog_trip():
    for status, cause in (
        (8, Cause.DEVICE_FAULT),
        (16, Cause.DEVICE_FAULT),
        (32, Cause.DEVICE_FAULT),
        (2, Cause.DEVICE_WATCHDOG),
    ):
        supervisor = running()
        supervisor.judge_reading(10.0, status)
        assert supervisor.cause is cause


def test_nothing_trips_while_nothing_is_driven():
    supervisor = Supervisor(limits())
    supervisor.judge_reading(1000.0, 8)
    supervisor.judge_exchange(False, 10_000 * MS)
    assert supervisor.state is State.DISARMED
