"""Control loops on a fake link, with a compensator that halves."""

from math import nan

import numpy as np

from piezod.control import ControlLoop, RingReader, Segment, TableReference
from tests.unit.control.fake_bench import FakeClock
from tests.unit.control.test_limits import limits

DT_S = 0.001


class Halving:
    """Reference [N] -> volts by 2 N/V, with a list of every commit."""

    def __init__(self):
        self.committed = []

    def reset(self):
        self.committed.clear()

    def plan(self, reference):
        return reference / 2.0

    def commit(self, voltage_V):
        self.committed.append(voltage_V)

    def produced_N(self):
        return 2.0 * self.committed[-1] if self.committed else nan


def make_loop(link, ring_log, **changes):
    return ControlLoop(link, limits(**changes), FakeClock(), ring_log, DT_S, approach_V_per_s=200.0)


def rows_of(tmp_path):
    return RingReader(tmp_path / "ring").read()


def armed_loop(link, ring_log, *, values=None, **changes):
    """Armed loop that approaches 60 N, 30 V."""
    loop = ControlLoop(link, limits(**changes), FakeClock(), ring_log, DT_S, 200.0, readback_within_V=2.0)
    loop.arm(Segment("work", TableReference(np.full(10**5, 60.0) if values is None else values), Halving()))
    return loop


def run(loop, ticks):
    for _ in range(ticks):
        loop.run_tick()
        loop._clock.wait()
