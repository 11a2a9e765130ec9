"""Faults of clock, readings, model and reference, injected into a bench with a manually stepped clock."""

import contextlib
import gc
import itertools
from math import nan

import numpy as np

from piezod.config import RealTimeConfig
from piezod.control import State, real_time
from piezod.errors import CheckFailedError
from piezod.transport.modbus import ModbusLink
from tests.contract.judged_bench import FaultyWire
from tests.faults.bench_pool import Observation
from tests.faults.manual_clock_bench import TICK_MS, ManualClockBench

SETTLED = (State.FAULT, State.DISARMED)


@contextlib.contextmanager
def _manual_clock_bench(**arguments):
    bench = ManualClockBench(**arguments)
    try:
        yield bench
    finally:
        bench.close()


def _observe(bench, fault, *, most_ms, begun_ns=None):
    """Run until the bench is in FAULT or DISARMED, at most `most_ms`, and return the observation."""
    begun_ns = bench.clock.time_ns if begun_ns is None else begun_ns
    bench.rows()
    keeps_running = "RUNNING" in fault.expect.states
    while bench.clock.time_ns - begun_ns < most_ms * 1e6 and (keeps_running or bench.state not in SETTLED):
        bench.run(1)
    rows = bench.rows()
    safe = np.flatnonzero(np.isin(rows["state"], (State.RAMP_DOWN, State.FAULT)))
    after_ms = (int(rows["time_ns"][safe[0]]) - begun_ns) / 1e6 + TICK_MS if safe.size else 0.0
    observed = Observation(
        bench.state.name, text=bench.cause, after_ms=after_ms, wrong=bench.judge.wrong, armings=bench.armings
    )
    observed.figures = {
        "failed": int((rows["result"] != 0).sum()),
        "missed": bench.clock.missed,
        "highest_V": float(rows["voltage_V"].max()) if rows.size else nan,
        "spikes": bench.loop.supervisor.spikes,
        "clamped": int((np.abs(rows["planned_V"] - 70.0) > 70.0).sum()),  # outside 0 to 140 V
        "refused": int((~np.isfinite(rows["planned_V"])).sum()),
        "slewed": int((np.abs(rows["planned_V"] - rows["voltage_V"]) > 1e-3).sum()),
    }
    return observed


def loop_overruns(pool, fault, *, ticks, late_ms, most_ms=2000):
    """Delay successive ticks beyond the deadline of the next tick."""
    with _manual_clock_bench() as bench:
        bench.arm()
        begun_ns = bench.clock.time_ns
        bench.clock.late_ns = round(1e6 * late_ms)
        bench.run(ticks)
        bench.clock.late_ns = 0
        return _observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns)


def loop_pause(pool, fault, *, pause_ms, most_ms=2000):
    """Advance the clock without a tick, as a suspended machine does; the device continues."""
    with _manual_clock_bench() as bench:
        bench.arm()
        commands = bench.device.command_echo
        bench.advance_clock(pause_ms)
        begun_ns = bench.clock.time_ns
        observed = _observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns)
        observed.figures["commands_afterwards"] = (bench.device.command_echo - commands) & 0xFFFF
        return observed


def loop_reading(pool, fault, *, forces_N=(), creep_N_per_s=0.0, samples=0, limits=None, most_ms=3000):
    """Replace the reading of the load cell: each of `forces_N` in turn, or the true force with a growing offset."""
    observed = []
    for value in forces_N or (0.0,):
        with _manual_clock_bench(limits=limits) as bench:
            bench.arm()
            begun_ns = bench.clock.time_ns
            bench.wire.lie = _creeping(bench, creep_N_per_s) if creep_N_per_s else lambda _, value=value: float(value)
            if samples:
                bench.run(samples)
                bench.wire.lie = None
            observed.append(_observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns))
    worst = max(observed, key=lambda one: (bool(one.deviations(fault)), one.after_ms))
    worst.figures["variants"] = len(observed)
    return worst


def loop_pattern(pool, fault, *, force_N, wrong, right, limits=None, most_ms=10_000):
    """Replace `wrong` readings of the load cell in a row by `force_N`, then leave `right` readings, and so on."""
    with _manual_clock_bench(limits=limits) as bench:
        bench.arm()
        begun_ns, count = bench.clock.time_ns, itertools.count()
        bench.wire.lie = lambda true_N: float(force_N) if next(count) % (wrong + right) < wrong else true_N
        return _observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns)


def loop_arming(pool, fault, *, forces_N):
    """Arm while the load cell gives these forces in turn, the last one from then on."""
    forces = iter(forces_N)
    with _manual_clock_bench() as bench:
        bench.wire.lie = lambda _: float(next(forces, forces_N[-1]))
        refusal = ""
        try:
            bench.arm()
        except CheckFailedError as error:
            refusal = str(error)
        observed = _observe(bench, fault, most_ms=10)
        observed.text += refusal
        return observed


def loop_status(pool, fault, *, status, limits, most_ms=3000):
    """The status register of the device changes to other bits."""
    with _manual_clock_bench(limits=limits) as bench:
        bench.arm()
        begun_ns = bench.clock.time_ns
        bench.wire.status = status
        return _observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns)


def loop_refused(pool, fault, *, refused, kept, limits=None, most_ms=10_000):
    """The device refuses `refused` requests in a row, then takes `kept`, and so on."""
    with _manual_clock_bench(limits=limits) as bench:
        bench.arm()
        begun_ns = bench.clock.time_ns
        bench.wire.faults = ([("refused", 0)] * refused + [("", 0)] * kept) * most_ms
        return _observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns)


def loop_second_master(pool, fault):
    """Another program writes the present voltage in the rest of each tick, as a second daemon would."""
    with _manual_clock_bench() as bench:
        bench.arm()
        config = bench.config.link.model_copy(update={"heartbeat_within_s": 10.0})
        other = ModbusLink(config, FaultyWire(bench.device, bench.clock, timeout_ms=3))

        def write_too(true_N):
            other.exchange(bench.link.written_V)
            return true_N

        begun_ns = bench.clock.time_ns
        bench.wire.lie = write_too  # called when the reply of each tick has arrived
        return _observe(bench, fault, most_ms=3000, begun_ns=begun_ns)


class Gain:
    """Compensator of a model with another gain than that of the bench."""

    def __init__(self, gain_N_per_V):
        self._gain, self._voltage_V = gain_N_per_V, nan

    def reset(self):
        self._voltage_V = nan

    def plan(self, reference):
        return reference / self._gain

    def commit(self, voltage_V):
        self._voltage_V = voltage_V

    def produced_N(self):
        return self._gain * self._voltage_V


def loop_out_of_reach(pool, fault, *, reference_N, gain_N_per_V=2.0, falls_N=0.0, most_ms=5000):
    """Follow a reference that needs more than the highest voltage; then the reading falls by `falls_N`."""
    rise_N = np.linspace(20.0, reference_N, 500)
    table = np.concatenate((rise_N, np.full(60_000, float(reference_N))))
    limits = {"tracking_trip_N": 100.0, "tracking_trip_ms": 100.0, "force_rate_trip_N_per_s": None}
    with _manual_clock_bench(limits=limits, reference=table, compensator=Gain(gain_N_per_V)) as bench:
        bench.arm(0)
        begun_ns = bench.clock.time_ns
        if falls_N:
            bench.run(2000)
            begun_ns = bench.clock.time_ns
            bench.wire.lie = lambda true_N: true_N - falls_N
        return _observe(bench, fault, most_ms=most_ms, begun_ns=begun_ns)


def _creeping(bench, rate_N_per_s):
    """Function that adds an offset which grows from now on."""
    begun_ns = bench.clock.time_ns
    return lambda force_N: force_N + rate_N_per_s * 1e-9 * (bench.clock.time_ns - begun_ns)


class FailingCompensator:
    """Compensator that plans correctly until `failing` is set, then returns the given values in turn."""

    def __init__(self, planned):
        self._planned, self._ticks, self.failing = planned, 0, False

    def reset(self):
        pass

    def plan(self, reference):
        if not self.failing:
            return reference / 2.0
        self._ticks += 1
        value = self._planned[self._ticks % len(self._planned)]
        if value == "raises":
            raise ZeroDivisionError
        return float(value)

    def commit(self, voltage_V):
        self.voltage_V = voltage_V

    def produced_N(self):
        return 2.0 * self.voltage_V


def loop_model(pool, fault, *, planned, most_ms=1000):
    """The inverse plans values out of range, non-finite or alternating values, or raises an exception."""
    compensator = FailingCompensator(planned)
    with _manual_clock_bench(compensator=compensator) as bench:
        bench.arm()
        compensator.failing = True
        return _observe(bench, fault, most_ms=most_ms)


def loop_reference(pool, fault, *, forces_N, loops=True, holds=False, most_ms=3000):
    """Follow a reference of these forces, each for 200 ticks."""
    values = np.repeat(np.asarray(forces_N, dtype=float), 200)
    with _manual_clock_bench(
        reference=values, loops=loops, holds=holds, limits={"force_rate_trip_N_per_s": None}
    ) as bench:
        bench.arm(settled_ticks=1)
        return _observe(bench, fault, most_ms=most_ms)


def loop_windup(pool, fault, *, out_of_reach_N, for_ms, most_ms=600):
    """Follow an unreachable reference, then a reachable one, and count the ticks with the voltage at its limit."""
    values = np.concatenate((np.full(1000, 100.0), np.full(for_ms, out_of_reach_N), np.full(100_000, 100.0)))
    limits = {"force_trip_N": 900.0, "force_rate_trip_N_per_s": None}
    with _manual_clock_bench(reference=values, limits=limits) as bench:
        bench.arm(settled_ticks=1000 + for_ms - 10)
        top_V = bench.loop.limiter.applied_V
        bench.run(10)
        ticks = 0
        while bench.loop.limiter.applied_V >= top_V - 1e-9 and ticks < most_ms:
            bench.run(1)
            ticks += 1
        observed = _observe(bench, fault, most_ms=most_ms)
        observed.figures |= {"ticks_at_the_end": ticks, "top_V": top_V}
        return observed


def loop_collector(pool, fault, *, ticks):
    """Produce cyclic garbage under the real-time settings of the daemon and count garbage collections."""
    collections = []
    gc.callbacks.append(lambda phase, _info: collections.append(phase))
    try:
        with (
            _manual_clock_bench() as bench,
            real_time(RealTimeConfig(fifo_priority=0, lock_memory=False, hold_cpu_latency=False)),
        ):
            bench.arm()
            collections.clear()
            garbage = []
            for _ in range(ticks):
                garbage.append([garbage])
                bench.run(1)
            found = len(collections)
            observed = _observe(bench, fault, most_ms=10)
    finally:
        gc.callbacks.pop()
    observed.figures["collections"] = found
    return observed


INJECTORS = {
    "loop_overruns": loop_overruns,
    "loop_pause": loop_pause,
    "loop_reading": loop_reading,
    "loop_pattern": loop_pattern,
    "loop_second_master": loop_second_master,
    "loop_arming": loop_arming,
    "loop_status": loop_status,
    "loop_refused": loop_refused,
    "loop_out_of_reach": loop_out_of_reach,
    "loop_model": loop_model,
    "loop_reference": loop_reference,
    "loop_windup": loop_windup,
    "loop_collector": loop_collector,
}
