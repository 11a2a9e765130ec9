"""The voltage writer in the loop: which voltages are written after failures, pauses and restarts, and committed."""

import numpy as np
import pytest

from piezod.control import Cause, ControlLoop, Segment, State, TableReference
from piezod.transport import ExchangeResult
from tests.unit.control.fake_bench import FakeClock, FakeLink
from tests.unit.control.loops import DT_S, Halving, armed_loop, make_loop, run
from tests.unit.control.test_limits import limits


def test_a_failed_exchange_commits_nothing(ring_log):
    link, compensator = FakeLink(), Halving()
    link.fails = lambda number: number % 3 == 0
    loop = make_loop(link, ring_log)
    loop.drive(Segment("table", TableReference(np.full(60, 10.0)), compensator))
    assert compensator.committed == link.voltages
    assert loop.counts.failed_exchanges > 0


def test_a_voltage_with_an_invalid_reading_was_written_and_is_committed(ring_log):
    link, compensator = FakeLink(), Halving()
    exchange = link.exchange
    link.exchange = lambda voltage_V: (exchange(voltage_V), ExchangeResult.NOT_FINITE)[link.exchanges % 2]
    make_loop(link, ring_log).drive(Segment("table", TableReference(np.full(60, 10.0)), compensator))
    assert compensator.committed == link.voltages


def test_after_a_failed_exchange_the_loop_reads_before_it_writes(ring_log):
    link, asked = FakeLink(), []
    exchange = link.exchange
    link.exchange = lambda voltage_V: (asked.append("write"), exchange(voltage_V))[1]
    link.poll = lambda: (asked.append("read"), ExchangeResult.OK)[1]
    loop = armed_loop(link, ring_log)
    link.fails = lambda number: number == 50
    run(loop, 60)
    assert asked[50] == "read"
    assert asked.count("read") == 1


def test_a_device_that_has_restarted_gets_no_more_voltages(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    link.reading.heartbeat = 5000
    link.fails = lambda number: number == 301
    run(loop, 1)

    def poll():
        link.reading.heartbeat = 3
        return ExchangeResult.OK

    link.poll = poll
    written = len(link.voltages)
    run(loop, 50)
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.DEVICE_RESTARTED)
    assert len(link.voltages) == written


def test_an_output_found_at_rest_is_a_restart_even_without_a_heartbeat(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    link.fails = lambda number: number == 301
    run(loop, 1)

    def poll():
        link.reading.voltage_readback_V = 0.0
        return ExchangeResult.OK

    link.poll = poll
    written = len(link.voltages)
    run(loop, 50)
    assert loop.supervisor.fault is Cause.DEVICE_RESTARTED
    assert len(link.voltages) == written


def test_a_process_that_has_paused_writes_no_voltage_afterwards(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    loop._clock.tick += 2000
    written = len(link.voltages)
    run(loop, 50)
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.STOOD_STILL)
    assert len(link.voltages) == written


def test_a_process_that_pauses_within_a_tick_does_not_write_its_plan(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    compensator, written = loop._planner.segment.compensator, len(link.voltages)
    plan = compensator.plan

    def stopped_while_planning(reference):
        loop._clock.tick += 2000
        return plan(reference)

    compensator.plan = stopped_while_planning
    run(loop, 1)
    compensator.plan = plan
    run(loop, 50)
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.STOOD_STILL)
    assert len(link.voltages) == written


def read_back_always(link, readback_V):
    """Let the device read back one voltage, whatever is written."""
    exchange = link.exchange

    def stays(voltage_V):
        result = exchange(voltage_V)
        link.reading.voltage_readback_V = readback_V
        return result

    link.exchange = stays


def test_an_output_that_does_not_read_back_at_rest_is_a_fault(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    read_back_always(link, 30.0)
    loop.request_stop()
    run(loop, 1000)
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.READBACK)


def test_the_readback_has_the_time_of_a_lost_connection_to_reach_rest_from_the_last_step_on(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log, comm_loss_ms=150.0)
    run(loop, 300)
    read_back_always(link, 30.0)
    loop.request_stop()
    ticks_at_rest = 0
    while loop.supervisor.state is State.RAMP_DOWN or not ticks_at_rest:
        run(loop, 1)
        ticks_at_rest += link.voltages[-1] == 0.0
        assert ticks_at_rest < 300
    assert ticks_at_rest * DT_S == pytest.approx(0.150, abs=2.5 * DT_S)


def test_failed_exchanges_are_counted_and_good_ones_are_not(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    assert loop.counts.failed_exchanges == 0
    link.fails = lambda number: 301 <= number < 306
    run(loop, 50)
    assert loop.counts.failed_exchanges == 5


def test_an_output_that_nobody_drives_is_ramped_down_from_its_readback(ring_log):
    link = FakeLink()
    loop = ControlLoop(link, limits(), FakeClock(), ring_log, DT_S, 200.0, readback_within_V=2.0)
    link.written_V = 60.0
    assert loop.bring_down(60.0) is Cause.NONE
    assert link.voltages[0] == pytest.approx(59.6)
    assert link.voltages[-1] == pytest.approx(0.0, abs=1e-9)
    assert loop.supervisor.state is State.DISARMED


def test_a_command_that_may_arrive_after_the_watchdog_of_the_device_is_not_sent(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)
    ticks = round(1e-3 * limits().device_watchdog_ms / DT_S)
    link.fails = lambda number: number == 301
    run(loop, 1)
    link.poll = lambda: ExchangeResult.TIMEOUT
    run(loop, ticks - 3)  # two ticks at least are kept in reserve
    written = len(link.voltages)
    link.poll = lambda: ExchangeResult.OK
    run(loop, 1)
    assert len(link.voltages) == written
