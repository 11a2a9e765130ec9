"""In no sequence of faults, commands and ticks does the amplifier leave its range or its slew."""

import contextlib
import os
import tempfile
from math import nan
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from piezod.config import load_bench
from piezod.control import Cause, ControlLoop, RingLog, Segment, State, TableReference, check_ready
from piezod.errors import PiezodError
from piezod.transport.modbus import ModbusLink
from tests.contract.judged_bench import MS, FaultyWire, HandClock, Judge, make_device, restart

BENCH = Path(__file__).parents[2] / "config" / "bench.yaml"
PERIOD_NS = MS
LIES = {
    "none": None,
    "nan": lambda force_N: nan,
    "stuck": lambda force_N: 12.5,
    "saturated": lambda force_N: 999.0,
    "too high": lambda force_N: 400.0,
    "gone": lambda force_N: 0.0,
    "reversed": lambda force_N: -force_N,
    "impossible": lambda force_N: 1e30,
}


class Wild:
    """Plans what it likes: now and then no number, out of range, or nothing but an error."""

    def __init__(self, seed, wildness):
        self.random, self.wildness = np.random.default_rng(seed), wildness

    def reset(self):
        pass

    def plan(self, reference):
        if self.random.random() >= self.wildness:
            return reference / 2.0
        wild = self.random.choice(5)
        if wild == 4:
            raise ZeroDivisionError
        return (nan, float("inf"), -1e9, 1e9)[wild]

    def commit(self, voltage_V):
        self.voltage_V = voltage_V

    def produced_N(self):
        return 2.0 * self.voltage_V


class Envelope(RuleBasedStateMachine):
    """One bench, one daemon's loop, and everything that can happen to them."""

    @initialize(
        slew=st.sampled_from([600.0, 4000.0]),
        slew_down=st.sampled_from([None, 500.0, 2000.0]),
        acceleration=st.sampled_from([None, None, 2e5]),
        step=st.sampled_from([0.0, 0.0, 0.1]),
        action=st.sampled_from(["ramp_down", "hold", "zero"]),
        watchdog_ms=st.sampled_from([100, 100, 0]),
        sign_check=st.booleans(),
        seed=st.integers(0, 2**16),
    )
    def build(self, slew, slew_down, acceleration, step, action, watchdog_ms, sign_check, seed):
        bench = load_bench(BENCH)
        limits = bench.limits.model_copy(
            update={
                "slew_V_per_s": slew,
                "slew_down_V_per_s": slew_down,
                "acceleration_V_per_s2": acceleration,
                "voltage_step_V": step,
                "comm_loss_action": action,
                "device_watchdog_ms": watchdog_ms,
                "tracking_trip_N": None,
            }
        )
        without = () if watchdog_ms else ("device_watchdog",)
        self.config = bench.model_copy(
            update={"limits": limits, "arming": bench.arming.model_copy(update={"without": without})}
        )
        self.clock = HandClock(PERIOD_NS)
        self.device, self.amplifier = make_device(self.clock, seed)
        self.amplifier.judge = Judge(
            limits.voltage_min_V, limits.voltage_max_V, slew, slew_down or slew, 1e-3, self.amplifier.step_s
        )
        link = bench.link.model_copy(update={"heartbeat_within_s": 10.0})  # of the test's own time
        self.wire = FaultyWire(self.device, self.clock, timeout_ms=20)
        self.link = ModbusLink(link, self.wire)
        self.folder = tempfile.TemporaryDirectory()
        self.ring = RingLog(Path(self.folder.name) / "ring", 100)
        self.loop = ControlLoop(
            self.link,
            limits,
            self.clock,
            self.ring,
            1e-3,
            bench.arming.voltage_V_per_s,
            sign_check=bench.arming.sign_check if sign_check else None,
            readback_within_V=bench.arming.readback_within_V,
        )
        self.seed = seed
        self.armed_by_hand = 0
        self.was_driving = False
        self.loop._link.poll()

    @property
    def state(self):
        return self.loop.supervisor.state

    def run(self, ticks):
        for _ in range(ticks):
            with contextlib.suppress(ZeroDivisionError):
                self.loop.run_tick()
            assert self.was_driving or not self.loop.supervisor.driving, "armed by itself"
            self.was_driving = self.loop.supervisor.driving
            self.loop.wait()
        self.device.catch_up()

    def sleep(self, duration_s):
        self.clock.time_ns += round(1e9 * duration_s)
        self.device.catch_up()

    @rule(ticks=st.integers(1, 400))
    def tick(self, ticks):
        self.run(ticks)

    @rule(late_us=st.lists(st.integers(0, 2500), min_size=1, max_size=40))
    def tick_late(self, late_us):
        for late in late_us:
            self.clock.late_ns = late * 1000
            self.run(1)
        self.clock.late_ns = 0

    @rule(
        kind=st.sampled_from(["steady", "steps", "noise", "wild"]),
        cycle=st.booleans(),
        hold=st.booleans(),
        seed=st.integers(0, 2**16),
    )
    def arm(self, kind, cycle, hold, seed):
        random = np.random.default_rng(seed)
        values = {
            "steady": 150.0 + 100.0 * np.sin(np.arange(900) / 50.0),
            "steps": np.repeat(random.uniform(-50.0, 500.0, 30), 30),
            "noise": random.uniform(0.0, 300.0, 900),
            "wild": np.full(900, 120.0),
        }[kind]
        compensator = Wild(seed, 0.3 if kind == "wild" else 0.0)
        reset = TableReference(np.concatenate((np.linspace(0, 140, 300), np.linspace(140, 0, 300)))) if cycle else None
        reference = TableReference(values, ramp_down_on_lapse=not hold)
        if self.state is State.DISARMED:
            with contextlib.suppress(PiezodError):
                check_ready(self.config, self.link, self.sleep)
                self.loop.arm(Segment(kind, reference, compensator, reset))
                self.was_driving = self.loop.supervisor.driving

    @rule(hasty=st.booleans())
    def stop(self, hasty):
        self.loop.supervisor.stop(fast=hasty)

    @rule()
    def reset(self):
        self.loop.supervisor.reset(at_rest=self.state is State.FAULT)

    @rule(share=st.floats(0.3, 1.0))
    def tighten(self, share):
        limits = self.config.limits
        tighter = limits.model_copy(
            update={
                "voltage_max_V": limits.voltage_max_V * share,
                "slew_V_per_s": limits.slew_V_per_s * share,
                "force_trip_N": limits.force_trip_N * share,
            }
        )
        if limits.slew_down_V_per_s is not None or limits.acceleration_V_per_s2 is None:
            self.loop.set_limits(tighter)

    @rule(ms=st.integers(1, 3000))
    def stand_still(self, ms):
        self.clock.time_ns += ms * MS
        self.device.catch_up()
        self.run(2)

    @rule(
        faults=st.lists(
            st.tuples(st.sampled_from(["lost", "unanswered", "refused", "garbled", "late"]), st.integers(0, 6)),
            min_size=1,
            max_size=12,
        ),
        ticks=st.integers(1, 60),
    )
    def break_exchanges(self, faults, ticks):
        self.wire.faults = list(faults)
        self.run(ticks)
        self.wire.faults = []

    @rule(ticks=st.integers(1, 500))
    def pull_the_cable(self, ticks):
        self.wire.up = False
        self.run(ticks)
        self.wire.up = True

    @rule(lie=st.sampled_from(sorted(LIES)), ticks=st.integers(1, 300))
    def lie_about_the_force(self, lie, ticks):
        self.wire.lie = LIES[lie]
        self.run(ticks)
        self.wire.lie = None

    @rule(pause=st.integers(0, 400))
    def restart_the_device(self, pause):
        restart(self.device, self.amplifier)
        self.wire.broken = True  # as a closed connection is noticed: at the next exchange
        self.clock.time_ns += pause * MS
        self.device.catch_up()
        self.run(1)

    @precondition(lambda self: hasattr(self, "loop"))
    @rule(bits=st.sampled_from([8, 16, 32]), ticks=st.integers(1, 300))
    def lose_the_amplifier(self, bits, ticks):
        """It comes back when it is commanded to rest: a tripped amplifier is switched on by hand."""
        self.amplifier.judge.excused = True
        self.amplifier.set_fault(bits)
        self.run(ticks)
        while self.loop.supervisor.driving or self.amplifier.command_V > 0.0:
            self.amplifier.set_watchdog(0.001, safe_V=0.0, ramp_V_per_s=400.0)
            self.run(50)
        self.amplifier.set_fault(0)

    @invariant()
    def amplifier_saw_nothing_outside_its_envelope(self):
        if hasattr(self, "amplifier"):
            assert not self.amplifier.judge.wrong, self.amplifier.judge.wrong[:3]

    def teardown(self):
        """Whatever happened: asked to stop, the bench comes to rest, or to a latched fault."""
        if not hasattr(self, "loop"):
            return
        try:
            self.loop.supervisor.stop()
            self.run(1500)
            assert self.state in (State.DISARMED, State.FAULT)
            self.amplifier_saw_nothing_outside_its_envelope()
            if self.state is State.DISARMED and self.loop.supervisor.cause is Cause.SAFE:
                assert abs(self.amplifier.output_V) < 2.1
        finally:
            self.ring.close()
            self.folder.cleanup()


def test_an_amplifier_that_is_too_hot_and_still_drives_is_ramped_to_the_end():
    bench = Envelope()
    bench.build(600.0, None, None, 0.0, "ramp_down", watchdog_ms=100, sign_check=False, seed=0)
    bench.arm(cycle=False, hold=False, kind="steady", seed=0)
    bench.tick(ticks=56)
    bench.lose_the_amplifier(bits=16, ticks=100)
    assert bench.state is State.FAULT
    assert bench.amplifier.judge.wrong == []
    bench.teardown()


TestEnvelope = Envelope.TestCase
TestEnvelope.settings = settings(
    max_examples=int(os.environ.get("PIEZOD_ENVELOPE_EXAMPLES", "25")),
    stateful_step_count=25,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
