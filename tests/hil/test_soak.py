"""Ten seconds of the soak: what does not depend on the machine."""

import os
from pathlib import Path

from tests.studies.soak import MOST_RESIDENT_MB, rows, soak

DURATION_S = 10.0
RATE_HZ = 200.0  # a busy machine may be slow, the memory does not mind


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
