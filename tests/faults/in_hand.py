"""Faults of a bench whose time is turned by hand: what the loop does about clock, values and model, to the tick."""

import contextlib
import gc
from math import nan

import numpy as np

from piezod.config import RealTimeConfig
from piezod.control import State, real_time
from tests.faults.hand import TICK_MS, HandBench
from tests.faults.stand import Seen

SETTLED = (State.FAULT, State.DISARMED)


@contextlib.contextmanager
def _hand(**arguments):
    bench = HandBench(**arguments)
    try:
        yield bench
    finally:
        bench.close()


def _tell(bench, fault, *, most_ms, begun_ns=None):
    """Run until the bench has come to the expected state, or so long; what was seen."""
    begun_ns = bench.clock.time_ns if begun_ns is None else begun_ns
    bench.rows()
    calm = "RUNNING" in fault.expect.states
    while bench.clock.time_ns - begun_ns < most_ms * 1e6 and (calm or bench.state not in SETTLED):
        bench.run(1)
    rows = bench.rows()
    safe = np.flatnonzero(np.isin(rows["state"], (State.RAMP_DOWN, State.FAULT)))
    after_ms = (int(rows["time_ns"][safe[0]]) - begun_ns) / 1e6 + TICK_MS if safe.size else 0.0
    seen = Seen(bench.state.name, text=bench.cause, after_ms=after_ms, wrong=bench.judge.wrong, armings=bench.armings)
    seen.figures = {
        "failed": int((rows["result"] != 0).sum()),
        "missed": bench.clock.missed,
        "highest_V": float(rows["voltage_V"].max()) if rows.size else nan,
        "spikes": bench.loop.supervisor.spikes,
        "clamped": int((np.abs(rows["planned_V"] - 70.0) > 70.0).sum()),  # outside 0 to 140 V
        "refused": int((~np.isfinite(rows["planned_V"])).sum()),
        "slewed": int((np.abs(rows["planned_V"] - rows["voltage_V"]) > 1e-3).sum()),
    }
    return seen


def hand_overruns(stand, fault, *, ticks, late_ms, most_ms=2000):
    """Ticks in a row that come later than the next one is due."""
    with _hand() as bench:
        bench.arm()
        begun_ns = bench.clock.time_ns
        bench.clock.late_ns = round(1e6 * late_ms)
        bench.run(ticks)
        bench.clock.late_ns = 0
        return _tell(bench, fault, most_ms=most_ms, begun_ns=begun_ns)


def hand_pause(stand, fault, *, pause_ms, most_ms=2000):
    """The clock goes on without a tick, as over a suspend; the device waits for nobody."""
    with _hand() as bench:
        bench.arm()
        commands = bench.device.command_echo
        bench.stand_still(pause_ms)
        begun_ns = bench.clock.time_ns
        seen = _tell(bench, fault, most_ms=most_ms, begun_ns=begun_ns)
        seen.figures["commands_afterwards"] = (bench.device.command_echo - commands) & 0xFFFF
        return seen


def hand_lie(stand, fault, *, forces_N=(), creep_N_per_s=0.0, samples=0, limits=None, most_ms=3000):
    """The load cell says something else: each of these forces in turn, or its own with a growing offset."""
    seen = []
    for value in forces_N or (0.0,):
        with _hand(limits=limits) as bench:
            bench.arm()
            begun_ns = bench.clock.time_ns
            bench.wire.lie = _creeping(bench, creep_N_per_s) if creep_N_per_s else lambda _, value=value: float(value)
            if samples:
                bench.run(samples)
                bench.wire.lie = None
            seen.append(_tell(bench, fault, most_ms=most_ms, begun_ns=begun_ns))
    worst = max(seen, key=lambda one: (bool(one.judged(fault)), one.after_ms))
    worst.figures["variants"] = len(seen)
    return worst


def _creeping(bench, rate_N_per_s):
    """A zero that moves from now on."""
    begun_ns = bench.clock.time_ns
    return lambda force_N: force_N + rate_N_per_s * 1e-9 * (bench.clock.time_ns - begun_ns)


class Mad:
    """Plans well until it goes mad; then, each tick, the next of these."""

    def __init__(self, planned):
        self._planned, self._ticks, self.mad = planned, 0, False

    def reset(self):
        pass

    def plan(self, reference):
        if not self.mad:
            return reference / 2.0
        self._ticks += 1
        value = self._planned[self._ticks % len(self._planned)]
        if value == "raises":
            raise ZeroDivisionError
        return float(value)

    def commit(self, voltage_V):
        pass


def hand_model(stand, fault, *, planned, most_ms=1000):
    """The model's inverse goes mad: out of range, no number, to and fro, or an exception."""
    compensator = Mad(planned)
    with _hand(compensator=compensator) as bench:
        bench.arm()
        compensator.mad = True
        return _tell(bench, fault, most_ms=most_ms)


def hand_reference(stand, fault, *, forces_N, loops=True, holds=False, most_ms=3000):
    """A reference of these forces, two hundred ticks each."""
    values = np.repeat(np.asarray(forces_N, dtype=float), 200)
    with _hand(reference=values, loops=loops, holds=holds, limits={"force_rate_trip_N_per_s": None}) as bench:
        bench.arm(settled_ticks=1)
        return _tell(bench, fault, most_ms=most_ms)


def hand_windup(stand, fault, *, out_of_reach_N, for_ms, most_ms=600):
    """A reference far out of reach for a while, then one within: how long the voltage stays at its end."""
    values = np.concatenate((np.full(1000, 100.0), np.full(for_ms, out_of_reach_N), np.full(100_000, 100.0)))
    limits = {"force_trip_N": 900.0, "force_rate_trip_N_per_s": None}
    with _hand(reference=values, limits=limits) as bench:
        bench.arm(settled_ticks=1000 + for_ms - 10)
        top_V = bench.loop.limiter.applied_V
        bench.run(10)
        ticks = 0
        while bench.loop.limiter.applied_V >= top_V - 1e-9 and ticks < most_ms:
            bench.run(1)
            ticks += 1
        seen = _tell(bench, fault, most_ms=most_ms)
        seen.figures |= {"ticks_at_the_end": ticks, "top_V": top_V}
        return seen


def hand_collector(stand, fault, *, ticks):
    """Garbage that would be collected, and a loop under the settings that the daemon runs with."""
    collections = []
    gc.callbacks.append(lambda phase, _info: collections.append(phase))
    try:
        with _hand() as bench, real_time(RealTimeConfig(fifo_priority=0, lock_memory=False, hold_cpu_latency=False)):
            bench.arm()
            collections.clear()
            rubbish = []
            for _ in range(ticks):
                rubbish.append([rubbish])
                bench.run(1)
            found = len(collections)
            seen = _tell(bench, fault, most_ms=10)
    finally:
        gc.callbacks.pop()
    seen.figures["collections"] = found
    return seen


INJECTORS = {
    "hand_overruns": hand_overruns,
    "hand_pause": hand_pause,
    "hand_lie": hand_lie,
    "hand_model": hand_model,
    "hand_reference": hand_reference,
    "hand_windup": hand_windup,
    "hand_collector": hand_collector,
}
