"""The guard of the device: when it reads, and what it does with the result."""

import pytest

from piezod.control.device_guard import COMPARE_NS, MARGIN_NS, OVERDUE_NS, TURN_NS, UNCONFIRMED_NS, DeviceGuard
from piezod.control.states import Cause, State
from piezod.control.supervisor import Supervisor
from piezod.transport import ExchangeResult
from tests.unit.control.test_limits import limits

MS = 1_000_000
OK = ExchangeResult.OK


class SupervisedLink:
    supervised = 2
    holds_command = True

    def __init__(self):
        self.result, self.reads, self.compared = OK, [], OK
        self.comparisons = 0

    def compare_command(self):
        self.comparisons += 1
        return self.compared

    def supervise(self, time_limit_s):
        self.reads.append(time_limit_s)
        return self.result


class Clock:
    left_ns = 5 * MS
    lateness_ns = 0
    waited_until_left_ns = -1
    after_wait_ns = None  # time that is left then, where the wake-up is late
    has_waited = False

    def sleep_until_before(self, left_ns):
        self.waited_until_left_ns, self.has_waited = left_ns, True

    def time_left_ns(self):
        waited, self.has_waited = self.has_waited, False
        return self.after_wait_ns if waited and self.after_wait_ns is not None else self.left_ns


class Subject:
    def __init__(self):
        self.link, self.clock, self.supervisor = SupervisedLink(), Clock(), Supervisor(limits())
        self.guard = DeviceGuard(self.link, self.supervisor, self.clock)
        self.now_ns, self.found = 10**9, []
        self.guard.end_tick(OK, self.now_ns, self.now_ns)
        self.supervisor.arm(self.now_ns)

    def ticks(self, seconds, result=OK, exchange_ns=MS // 2):
        end_ns = self.now_ns + round(1e9 * seconds)
        while self.now_ns < end_ns:
            self.now_ns += MS
            self.guard.end_tick(result, self.now_ns - exchange_ns, self.now_ns)
            self.found.append(self.guard.compare_command())


@pytest.fixture
def subject():
    return Subject()


def test_every_register_is_read_at_least_once_a_second(subject):
    subject.ticks(10.0)
    assert len(subject.link.reads) >= 10 * subject.link.supervised
    assert len(subject.link.reads) <= 1.1 * 10e9 / (TURN_NS / subject.link.supervised)


def test_the_device_guard_reads_nothing_while_disarmed(subject):
    subject.supervisor.state = State.DISARMED
    subject.ticks(3.0)
    assert subject.link.reads == []


def test_a_read_waits_for_room_in_the_tick_and_ends_within_it(subject):
    subject.clock.left_ns = MS // 2
    subject.ticks(0.1)
    assert subject.link.reads == []
    subject.clock.left_ns = 2 * MS
    subject.ticks(0.01)
    assert subject.link.reads == [pytest.approx(0.002)]


def test_an_overdue_read_does_not_wait_any_more(subject):
    subject.clock.left_ns = 0
    subject.ticks(1.0)
    assert subject.link.reads
    assert OVERDUE_NS + TURN_NS <= 10**9


@pytest.mark.parametrize("supervised", [1, 2, 5])
def test_every_register_is_read_at_once_after_a_failed_exchange(subject, supervised):
    """A restarted device may have lost any of them; a turn of half a second would find it too late."""
    subject.link.supervised = supervised
    subject.ticks(0.01)
    reads = len(subject.link.reads)
    subject.ticks(0.002)
    assert len(subject.link.reads) == reads
    subject.ticks(0.001, result=ExchangeResult.TIMEOUT)
    subject.ticks(0.001 * supervised)
    assert len(subject.link.reads) == reads + supervised
    subject.ticks(0.9e-9 * TURN_NS / supervised)
    assert len(subject.link.reads) == reads + supervised


@pytest.mark.parametrize(
    ("result", "cause", "state"),
    [
        (ExchangeResult.SETTING_CHANGED, Cause.SETTING_CHANGED, State.RAMP_DOWN),
        (ExchangeResult.WRONG_LOAD_CELL, Cause.WRONG_LOAD_CELL, State.RAMP_DOWN),
        (ExchangeResult.FOREIGN_COMMAND, Cause.FOREIGN_COMMAND, State.RAMP_DOWN),
        (ExchangeResult.SETPOINT_CHANGED, Cause.SETPOINT_CHANGED, State.RAMP_DOWN),
        (ExchangeResult.WRONG_DEVICE, Cause.WRONG_DEVICE, State.FAULT),  # no ramp: nothing is written to it
    ],
)
def test_a_change_is_a_latched_fault(subject, result, cause, state):
    subject.link.result = result
    subject.ticks(0.005)
    assert subject.supervisor.fault is cause
    assert subject.supervisor.state is state


def test_a_failed_read_is_repeated_and_trips_when_none_succeeds_for_three_seconds(subject):
    subject.link.result = ExchangeResult.DEVICE_EXCEPTION
    subject.ticks(0.9e-9 * UNCONFIRMED_NS)
    assert subject.supervisor.fault is Cause.NONE
    assert len(subject.link.reads) > 3
    subject.ticks(0.2e-9 * UNCONFIRMED_NS)
    assert subject.supervisor.fault is Cause.SETTING_CHANGED


def test_the_command_is_compared_once_in_fifty_milliseconds_halfway_to_the_next_tick(subject):
    subject.ticks(10.0)
    assert subject.link.comparisons == 10e9 / COMPARE_NS
    assert subject.clock.waited_until_left_ns == 5 * MS // 2
    subject.clock.left_ns = MS
    subject.ticks(0.1)
    assert (
        subject.clock.waited_until_left_ns == 5 * MS // 8 + MARGIN_NS
    )  # 1.25 times the exchange of half a millisecond


def test_where_ticks_begin_late_the_comparison_waits_until_it_is_overdue(subject):
    subject.clock.lateness_ns = 2 * MS
    subject.ticks(1e-9 * OVERDUE_NS - 0.01)
    assert subject.link.comparisons == 0
    subject.ticks(0.05)
    assert subject.link.comparisons == 1


def test_a_late_wake_up_puts_the_comparison_off_until_the_next_tick(subject):
    subject.clock.after_wait_ns = MS // 2
    subject.ticks(0.1)
    assert subject.link.comparisons == 0
    subject.clock.after_wait_ns = None
    subject.ticks(0.001)
    assert subject.link.comparisons == 1


def test_the_command_is_not_compared_while_disarmed_nor_after_a_failed_exchange(subject):
    subject.ticks(0.2, result=ExchangeResult.TIMEOUT)
    subject.supervisor.state = State.DISARMED
    subject.ticks(0.2)
    assert subject.link.comparisons == 0


def test_a_full_tick_delays_the_comparison_of_the_command_until_it_is_overdue(subject):
    subject.clock.left_ns = MS // 2
    subject.ticks(1e-9 * OVERDUE_NS - 0.01)
    assert subject.link.comparisons == 0
    subject.ticks(0.05)
    assert subject.link.comparisons == 1


@pytest.mark.parametrize("result", [ExchangeResult.FOREIGN_COMMAND, ExchangeResult.SETPOINT_CHANGED])
def test_another_command_is_reported(subject, result):
    subject.link.compared = result
    subject.ticks(0.05)
    assert subject.found.count(result) == 1


def test_a_comparison_that_fails_for_three_seconds_is_a_changed_setting(subject):
    subject.link.compared = ExchangeResult.DEVICE_EXCEPTION
    subject.ticks(0.9e-9 * UNCONFIRMED_NS)
    assert ExchangeResult.SETTING_CHANGED not in subject.found
    subject.ticks(0.2e-9 * UNCONFIRMED_NS)
    assert ExchangeResult.SETTING_CHANGED in subject.found


def test_results_of_exchanges_below_wrong_device_are_left_to_the_supervisor(subject):
    for result in ExchangeResult:
        if result <= ExchangeResult.UNVERIFIED:
            subject.guard.evaluate(result)
    assert subject.supervisor.fault is Cause.NONE
