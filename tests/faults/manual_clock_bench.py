"""A bench inside the test process with a manually stepped clock: control loop, link, emulated device, judged output.

A fault takes milliseconds of real time, and its time limits are exact to one tick.
"""

import tempfile
from pathlib import Path

import numpy as np

from piezod.config import load_bench
from piezod.control import CAUSE_TEXT, ControlLoop, RingLog, RingReader, Segment, State, TableReference, check_ready
from piezod.transport.modbus import ModbusLink
from tests.contract.judged_bench import MS, FaultyWire, HandClock, Judge, make_device, restart

BENCH = Path(__file__).parents[2] / "config" / "bench.yaml"
TICK_MS = 1.0
WITHOUT_TRACKING_TRIP = {"tracking_trip_N": None}


class Linear:
    """Compensator with a gain of 2 N/V, the average gain of the emulated stack."""

    def reset(self):
        pass

    def plan(self, reference):
        return reference / 2.0

    def commit(self, voltage_V):
        self.voltage_V = voltage_V

    def produced_N(self):
        return 2.0 * self.voltage_V


class ManualClockBench:
    """One control loop and one device at 1 kHz.

    Parameters
    ----------
    limits
        Values that replace limits of `config/bench.yaml`.
    reference
        Forces, one for each tick [N]; None: a sine of 0.5 Hz.
    loops
        Whether the reference restarts at its end.
    holds
        Whether the voltage is held at the end of the reference.
    compensator
        Compensator from force to voltage; None: a constant gain.
    """

    def __init__(self, *, limits=None, reference=None, loops=True, holds=False, compensator=None):
        bench = load_bench(BENCH)
        self.limits = bench.limits.model_copy(update=WITHOUT_TRACKING_TRIP | (limits or {}))
        self.config = bench.model_copy(update={"limits": self.limits})
        self.clock = HandClock(MS)
        self.device, self.amplifier = make_device(self.clock)
        slew = self.limits.slew_V_per_s
        self.judge = Judge(
            self.limits.voltage_min_V, self.limits.voltage_max_V, slew, slew, 1e-3, self.amplifier.step_s
        )
        self.amplifier.judge = self.judge
        self.wire = FaultyWire(self.device, self.clock, timeout_ms=3)
        self.link = ModbusLink(bench.link.model_copy(update={"heartbeat_within_s": 10.0}), self.wire)
        self._folder = tempfile.TemporaryDirectory()
        path = Path(self._folder.name) / "ring"
        self._ring = RingLog(path, 60_000)
        self.reader = RingReader(path)
        arming = bench.arming
        self.loop = ControlLoop(
            self.link, self.limits, self.clock, self._ring, 1e-3, 400.0,
            sign_check=arming.sign_check, readback_within_V=arming.readback_within_V,
        )  # fmt: skip
        values = 120.0 + 40.0 * np.sin(np.arange(2000) * np.pi / 1000) if reference is None else reference
        table = TableReference(values, loop=loops, ramp_down_on_lapse=not holds)
        self.segment = Segment("hand", table, compensator or Linear(), None)
        self.armings = 0
        self.link.poll()

    @property
    def state(self):
        return self.loop.supervisor.state

    @property
    def cause(self):
        return CAUSE_TEXT[self.loop.supervisor.cause]

    def run(self, ticks):
        """Run `ticks` ticks and count transitions to a driving state without a command."""
        for _ in range(ticks):
            before = self.loop.supervisor.driving
            self.loop.run_tick()
            self.armings += not before and self.loop.supervisor.driving
            self.loop.wait()
        self.device.catch_up()

    def run_to(self, *states, most):
        """Run until one of the states, at most `most` ticks; returns the elapsed time [ms]."""
        begun_ns = self.clock.time_ns
        for _ in range(most):
            if self.state in states:
                break
            self.run(1)
        return (self.clock.time_ns - begun_ns) / MS

    def arm(self, settled_ticks=300):
        """Arm and follow the reference for `settled_ticks` ticks."""
        check_ready(self.config, self.link, self._sleep)
        self.loop.arm(self.segment)
        self.run_to(State.RUNNING, most=3000)
        assert self.state is State.RUNNING, self.cause
        self.run(settled_ticks)

    def _sleep(self, duration_s):
        self.clock.time_ns += round(1e9 * duration_s)
        self.device.catch_up()

    def advance_clock(self, duration_ms):
        self.clock.time_ns += round(duration_ms * MS)
        self.device.catch_up()

    def restart_device(self):
        restart(self.device, self.amplifier)
        self.wire.broken = True

    def rows(self):
        return self.reader.read()

    def close(self):
        self._ring.close()
        self._folder.cleanup()
