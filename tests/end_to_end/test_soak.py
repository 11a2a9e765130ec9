"""Ten seconds of the soak: what does not depend on the machine."""

import os
from pathlib import Path

import numpy as np
import pytest

from piezod.control import Cause, State
from piezod.recording.ring_log import ROW_DTYPE
from tests.studies.soak import MOST_RESIDENT_MB, Soaked, _percentile_us, _take, rows, soak

DURATION_S = 10.0
RATE_HZ = 200.0  # a busy machine may be slow, the memory does not mind


@pytest.mark.slow
def test_a_busy_machine_costs_no_memory_no_descriptors_and_no_fault_but_deadlines():
    before = set(own_children())
    soaked = soak(DURATION_S, RATE_HZ)
    assert set(own_children()) <= before
    assert soaked.seconds >= DURATION_S
    assert soaked.ticks > 100
    assert soaked.ticks + soaked.missed <= 1.5 * soaked.seconds * RATE_HZ
    assert soaked.rows_dropped == 0
    assert not soaked.other_faults
    for process in soaked.processes:
        assert len(set(process.descriptors)) == 1, process
        assert max(process.resident_MB) < MOST_RESIDENT_MB, process
        assert process.resident_MB[-1] - process.resident_MB[0] < 5.0, process
    table = "\n".join(row.text() for row in rows(soaked))
    assert "missed ticks" in table
    assert "control: resident memory" in table


def own_children():
    return Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text(encoding="ascii").split()


def test_ticks_lost_between_and_within_two_looks_are_counted_and_faults_by_name():
    soaked = Soaked(1000.0)
    table = np.zeros(6, ROW_DTYPE)
    table["tick"] = [10, 11, 14, 15, 16, 17]  # 12 and 13 are missing
    table["lateness_ns"] = [20_000, 20_500, 1_500_000, 20_000, 21_000, 20_000]
    table["exchange_ns"] = [100_000, 2_500_000, 100_000, 100_000, 100_000, 100_000]
    table["state"] = [State.RUNNING] * 4 + [State.RAMP_DOWN, State.FAULT]
    table["cause"][5] = Cause.MISSED_TICKS
    following = _take(soaked, table, None)
    after = np.zeros(1, ROW_DTYPE)
    after["tick"] = 23  # 18 to 22 are missing
    assert _take(soaked, after, following) == 24
    assert (soaked.ticks, soaked.missed, soaked.stalls, soaked.longest_stall) == (7, 7, 2, 5)
    assert soaked.late_answers == 1
    assert soaked.faults == {"MISSED_TICKS": 1}
    assert soaked.other_faults == {}
    assert soaked.lateness[20] == 4
    assert soaked.over_period(soaked.lateness) == 1
    assert _percentile_us(soaked.lateness, 50.0) == 20.0


def test_periods_that_a_late_wake_up_lost_are_counted_whole():
    counts = np.zeros(5000, dtype=np.int64)
    counts[[30, 1200, 3999]] = [100, 2, 1]
    soaked = Soaked(1000.0)
    assert soaked.over_period(counts) == 3
    assert soaked.periods_lost(counts) == 2 * 1 + 3
