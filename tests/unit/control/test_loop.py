"""The loop on a fake link: which voltages are written, and when."""

import math

import numpy as np
import pytest

from piezod.control import Cause, Segment, State, TableReference
from piezod.control.references import Freshness
from piezod.model import DirectDrive
from piezod.operators import ImplicitInverse, PrandtlIshlinskii
from piezod.transport.status import STATUS_AMPLIFIER_FAULT
from tests.unit.control.fake_bench import FakeLink
from tests.unit.control.loops import Halving, armed_loop, make_loop, rows_of, run


def test_a_table_is_followed_from_approach_to_ramp_down(tmp_path, ring_log):
    link, compensator = FakeLink(), Halving()
    loop = make_loop(link, ring_log)
    values = np.linspace(20.0, 30.0, 500)
    assert loop.drive(Segment("ramp", TableReference(values), compensator)) is Cause.NONE
    rows = rows_of(tmp_path)
    running = rows[rows["state"] == State.RUNNING]
    np.testing.assert_array_equal(running["reference_N"], values)
    np.testing.assert_allclose(running["voltage_V"], values / 2.0)
    assert loop.supervisor.state is State.DISARMED
    assert link.voltages[-1] == 0.0
    assert compensator.committed == link.voltages


def test_the_first_reference_is_approached_no_faster_than_configured(ring_log):
    link = FakeLink()
    make_loop(link, ring_log).drive(Segment("jump", TableReference(np.full(10, 200.0)), Halving()))
    rise = np.diff([0.0, *link.voltages])
    assert rise.max() == pytest.approx(0.2)
    assert rise.min() == pytest.approx(-0.4)


def test_a_reset_cycle_reaches_the_top_and_comes_back_before_the_reference_starts(tmp_path, ring_log):
    link = FakeLink(lambda voltage_V: 0.1 * voltage_V)
    loop = make_loop(link, ring_log)
    cycle = TableReference(140.0 * (1 - np.abs(np.linspace(-1, 1, 1401))))
    loop.drive(Segment("work", TableReference(np.full(10, 10.0)), Halving(), cycle))
    rows = rows_of(tmp_path)
    arming = rows[rows["state"] == State.ARMING]
    assert arming["voltage_V"].max() == pytest.approx(140.0)
    assert (rows[rows["state"] == State.RUNNING]["tick"] > arming["tick"].max()).all()


def test_a_skipped_tick_skips_its_reference_value(tmp_path, ring_log):
    link = FakeLink()
    loop = make_loop(link, ring_log)
    clock = loop._clock
    wait = clock.wait
    clock.wait = lambda: (wait(), wait()) if clock.tick % 7 == 0 else wait()
    values = np.arange(100.0) * 0.1
    loop.drive(Segment("table", TableReference(values), Halving()))
    rows = rows_of(tmp_path)
    running = rows[rows["state"] == State.RUNNING]
    first = running["tick"][0]
    np.testing.assert_array_equal(running["reference_N"], values[running["tick"] - first])
    assert running.size < 100


def test_an_over_force_starts_the_ramp_down_in_the_next_tick_and_latches(tmp_path, ring_log):
    link = FakeLink(lambda voltage_V: 400.0 if voltage_V > 20.0 else 2.0 * voltage_V)
    loop = make_loop(link, ring_log)
    fault = loop.drive(Segment("too much", TableReference(np.full(1000, 60.0)), Halving()))
    assert fault is Cause.OVER_FORCE
    assert loop.supervisor.state is State.FAULT
    rows = rows_of(tmp_path)
    over = int(np.flatnonzero(rows["force_N"] > 360.0)[0])
    voltages = rows["voltage_V"]
    assert rows["state"][over] == State.RAMP_DOWN
    assert voltages[over + 1] < voltages[over]
    assert link.voltages[-1] == 0.0


def test_a_device_that_falls_silent_is_ramped_down_by_the_loop_and_then_left_to_its_watchdog(ring_log):
    link = FakeLink()
    loop = make_loop(link, ring_log)
    link.fails = lambda number: number > 100
    fault = loop.drive(Segment("silence", TableReference(np.full(5000, 10.0)), Halving()))
    assert fault is Cause.COMM_LOSS
    assert loop._clock.tick < 100 + 200 + 350 + 10


def test_only_a_fast_stop_ramps_at_the_slew_limit_however_often_a_stop_is_requested(ring_log):
    for requests, fall in (([False], 0.4), ([False] * 5, 0.4), ([False, True, False], 4.0)):
        link = FakeLink()
        loop = make_loop(link, ring_log)
        loop.begin(Segment("long", TableReference(np.full(10**5, 100.0)), Halving()))
        loop.supervisor.arm(0)
        for _ in range(400):
            loop.tick()
            loop._clock.wait()
        assert link.voltages[-1] == pytest.approx(50.0)
        for fast in requests:
            loop.request_stop(fast=fast)
        while loop.supervisor.driving:
            loop.tick()
            loop._clock.wait()
        falls = -np.diff(link.voltages)
        assert falls.max() == pytest.approx(fall)
        assert link.voltages[-1] == pytest.approx(0.0, abs=1e-6)


def test_a_plan_that_is_not_finite_keeps_the_voltage(ring_log):
    link = FakeLink()
    broken = Halving()
    broken.plan = lambda reference: float("nan") if reference > 15.0 else reference / 2.0
    make_loop(link, ring_log).drive(Segment("broken", TableReference(np.linspace(10, 20, 100)), broken))
    assert np.isfinite(link.voltages).all()
    assert max(link.voltages) == pytest.approx(7.5, abs=0.06)


def test_a_reference_that_ends_with_hold_keeps_the_voltage_until_stopped(ring_log):
    link = FakeLink()
    loop = make_loop(link, ring_log)
    loop.begin(Segment("short", TableReference(np.linspace(10, 20, 50), ramp_down_on_lapse=False), Halving()))
    loop.supervisor.arm(0)
    for _ in range(500):
        loop.tick()
        loop._clock.wait()
    assert loop.supervisor.state is State.HOLD
    assert set(link.voltages[-300:]) == {10.0}
    loop.request_stop()
    while loop.supervisor.driving:
        loop.tick()
        loop._clock.wait()
    assert link.voltages[-1] == pytest.approx(0.0, abs=1e-6)


def test_a_live_reference_that_falls_silent_is_held_and_followed_again_when_it_returns(ring_log):
    class Intermittent(TableReference):
        def read(self, tick, now_ns):
            self.freshness = Freshness.STALE if 100 <= tick < 150 else Freshness.LIVE
            self.ahead = 20.0 if tick < 150 else 22.0
            return self.ahead

    link = FakeLink()
    loop = make_loop(link, ring_log)
    loop.begin(Segment("live", Intermittent([0.0], ramp_down_on_lapse=False), Halving()))
    loop.supervisor.arm(0)
    states = []
    for _ in range(200):
        loop.tick()
        states.append(loop.supervisor.state)
        loop._clock.wait()
    assert states[99] is State.RUNNING
    assert set(states[100:150]) == {State.HOLD}
    assert set(states[150:]) == {State.RUNNING}
    assert set(link.voltages[100:150]) == {10.0}
    assert link.voltages[-1] == 11.0


def test_watch_writes_no_voltage(ring_log):
    link = FakeLink()
    loop = make_loop(link, ring_log)
    for _ in range(50):
        loop.run_tick()
        loop.wait()
    assert link.voltages == []


def test_the_inverse_of_a_known_plant_follows_to_rounding(tmp_path, ring_log):
    def operator():
        return PrandtlIshlinskii([0.0, 2.0, 6.0, 20.0], [0.7, 0.2, 0.1, 0.2], [0.0, 50.0], [2.0, 0.3])

    plant = operator()
    inverse = ImplicitInverse(operator())
    inverse.reset = lambda: None
    link = FakeLink(plant.step)
    loop = make_loop(link, ring_log)
    values = 150.0 - 100.0 * np.cos(np.linspace(0, 12, 3000))
    loop.drive(Segment("sine", TableReference(values), inverse))
    rows = rows_of(tmp_path)
    running = rows[rows["state"] == State.RUNNING]
    np.testing.assert_allclose(running["force_N"][1:], running["reference_N"][:-1], atol=1e-9)


def test_a_direct_drive_writes_its_table_as_it_is(tmp_path, ring_log):
    values = np.concatenate((np.linspace(0, 30, 200), np.linspace(30, 0, 200)))
    make_loop(FakeLink(), ring_log).drive(Segment("volts", TableReference(values), DirectDrive()))
    rows = rows_of(tmp_path)
    np.testing.assert_allclose(rows[rows["state"] == State.RUNNING]["voltage_V"], values, atol=1e-12)


def test_a_spike_lowers_the_voltage_by_one_tick_of_the_ramp_and_trips_nothing(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log, force_debounce_samples=2)
    run(loop, 300)
    link.plant = lambda voltage_V: 900.0
    run(loop, 1)
    link.plant = lambda voltage_V: 2.0 * voltage_V
    run(loop, 5)
    assert loop.supervisor.state is State.RUNNING
    assert loop.supervisor.spikes == 1
    assert min(link.voltages[-5:]) == pytest.approx(30.0 - 0.4)
    assert link.voltages[-1] == pytest.approx(30.0)


def test_after_an_exception_of_the_compensator_the_loop_ramps_down_without_it(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    run(loop, 300)

    def fail(*_):
        raise ZeroDivisionError("by zero")

    loop._planner.segment.compensator.plan = loop._planner.segment.compensator.commit = fail
    run(loop, 300)
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.CONTROLLER)
    assert loop.failure == "ZeroDivisionError: by zero"
    assert link.voltages[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.diff(link.voltages).min() >= -0.4 - 1e-9


def test_a_link_that_raises_again_and_again_ends_the_loop(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)

    def fail(*_):
        raise RuntimeError("broken")

    link.exchange = link.poll = fail
    with pytest.raises(RuntimeError):
        run(loop, 10)


def test_an_exception_between_two_ticks_latches_a_fault_and_does_not_end_the_ramp(ring_log):
    link = FakeLink()
    loop = armed_loop(link, ring_log)
    calls = []

    def fail():
        calls.append(loop.limiter.applied_V)
        if len(calls) > 300:
            raise OSError("the pipe is broken")

    loop.serve(fail)
    assert calls[300] == pytest.approx(30.0)
    assert (loop.supervisor.state, loop.supervisor.fault) == (State.FAULT, Cause.CONTROLLER)
    assert loop.failure == "OSError: the pipe is broken"
    assert link.voltages[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.diff(link.voltages).min() >= -0.4 - 1e-9


def test_an_exception_between_two_ticks_is_raised_while_nothing_is_driven(ring_log):
    def fail():
        raise OSError("the pipe is broken")

    with pytest.raises(OSError, match="broken"):
        make_loop(FakeLink(), ring_log).serve(fail)


def test_a_stop_while_arming_waits_for_its_reference_ends_disarmed_at_rest(ring_log):
    class Silent(TableReference):
        def read(self, tick, now_ns):
            self.freshness = Freshness.STALE
            return 0.0

    for ask in (lambda loop: loop.request_stop(), lambda loop: loop.supervisor.stop()):
        link = FakeLink()
        loop = make_loop(link, ring_log)
        link.reading.voltage_readback_V = link.written_V = 20.0
        loop.arm(Segment("silent", Silent([0.0]), Halving()))
        run(loop, 100)
        assert loop.supervisor.state is State.ARMING
        assert link.voltages[-1] == 20.0
        ask(loop)
        run(loop, 100)
        assert loop.supervisor.state is State.DISARMED
        assert link.voltages[-1] == pytest.approx(0.0, abs=1e-9)


class Late(TableReference):
    """Stale until the tick `live_from`, then 20 N."""

    live_from = 10**9

    def read(self, tick, now_ns):
        self.freshness = Freshness.STALE if tick < self.live_from else Freshness.LIVE
        self.ahead = 20.0
        return 20.0


def test_arming_without_a_reference_ends_disarmed_after_its_preparation_and_the_timeout(tmp_path, ring_log):
    cycle = TableReference(np.full(300, 5.0))
    for reset_cycle, planned in ((None, 700), (cycle, 1000)):  # 140 V at 0.2 V a tick
        loop = make_loop(FakeLink(), ring_log, arming_timeout_s=0.5)
        loop.arm(Segment("silent", Late([0.0]), Halving(), reset_cycle))
        run(loop, planned + 501)
        assert loop.supervisor.state is State.ARMING
        run(loop, 1)
        assert (loop.supervisor.state, loop.supervisor.cause) == (State.RAMP_DOWN, Cause.ARMING_TIMEOUT)
        run(loop, 100)
        assert (loop.supervisor.state, loop.supervisor.fault) == (State.DISARMED, Cause.NONE)
    rows = rows_of(tmp_path)
    assert (rows["cause"] == Cause.ARMING_TIMEOUT).any()


def test_a_reference_that_comes_within_the_timeout_is_followed(ring_log):
    loop = make_loop(FakeLink(), ring_log, arming_timeout_s=0.5)
    reference = Late([0.0])
    reference.live_from = 1100
    loop.arm(Segment("late", reference, Halving()))
    run(loop, 1500)
    assert loop.supervisor.state is State.RUNNING


def test_the_timeout_of_arming_does_not_end_a_run(ring_log):
    loop = make_loop(FakeLink(), ring_log, arming_timeout_s=0.01)
    loop.arm(Segment("work", TableReference(np.full(5000, 60.0)), Halving()))
    run(loop, 3000)
    assert loop.supervisor.state is State.RUNNING


def test_a_force_that_was_read_once_is_not_judged_again_while_no_reading_comes(ring_log):
    """The first force beyond the limit is suspect; two lost exchanges after it repeat it and confirm nothing."""
    link = FakeLink()
    loop = armed_loop(link, ring_log, force_debounce_samples=2, force_trip_N=360.0, stale_after_ms=50.0)
    run(loop, 200)
    assert loop.supervisor.state is State.RUNNING
    link.plant = lambda _voltage_V: 900.0
    run(loop, 1)
    assert loop.supervisor.force.suspect
    link.plant = lambda voltage_V: 2.0 * voltage_V
    last = link.exchanges
    link.fails = lambda number: number <= last + 2
    run(loop, 4)
    assert loop.supervisor.state is State.RUNNING
    assert loop.supervisor.spikes == 1


class TrippingLink(FakeLink):
    """Link to an amplifier that switches its output off, with `readback_V` then, and reports the fault."""

    tripped = False
    readback_V = 0.0

    def exchange(self, voltage_V):
        result = super().exchange(voltage_V)
        if self.tripped:
            self.reading.status = STATUS_AMPLIFIER_FAULT
            self.reading.voltage_readback_V = self.readback_V
        return result


def voltages_after_a_trip(ring_log, readback_V, earlier=None):
    link = TrippingLink()
    loop = armed_loop(link, ring_log, slew_V_per_s=1000.0, ramp_down_V_per_s=1000.0)
    run(loop, 200)
    assert loop.supervisor.state is State.RUNNING
    assert link.voltages[-1] == 30.0
    if earlier is not None:
        loop.supervisor.trip(earlier)
    link.tripped, link.readback_V = True, readback_V
    before = len(link.voltages)
    run(loop, 4)
    return link.voltages[before:]


def test_a_tripped_amplifier_at_rest_is_commanded_to_rest_so_that_it_does_not_jump_when_switched_on(ring_log):
    assert voltages_after_a_trip(ring_log, 0.0) == [30.0, 0.0]


def test_an_amplifier_that_trips_after_another_fault_is_commanded_to_rest_too(ring_log):
    assert voltages_after_a_trip(ring_log, 0.0, Cause.TRACKING) == [29.0, 0.0]


@pytest.mark.parametrize("readback_V", [2.5, math.nan])
def test_a_tripped_amplifier_that_is_not_known_to_be_at_rest_is_ramped_down(ring_log, readback_V):
    assert voltages_after_a_trip(ring_log, readback_V) == [30.0, 29.0, 28.0, 27.0]
