"""The ticks around a fault: which they are, whatever the blocks are, and that their disk disturbs nothing."""

import errno
import sqlite3

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.control import State
from piezod.recorder import fault_files
from piezod.recorder.fault_files import FaultFiles
from piezod.recorder.messages import Plan
from piezod.recorder.recording_files import recording_files
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import About
from piezod.recording.ring_log import ROW_DTYPE
from tests.benches.recorded_blocks import read_blocks
from tests.unit.recorder.test_ring_recorder import Bench

AROUND = 20
ABOUT = About(ROW_DTYPE, "ticks", {"bench": "b"}, "session", 10**9)


def plan_of(folder, **changes):
    settings = {"sync_every_s": 0.5, "file_bytes": 1e9, "file_s": 1e9, "folder_bytes": 1e12}
    faults = {"rows_around_fault": AROUND, "ramp_down": State.RAMP_DOWN, "fault": State.FAULT}
    return Plan(str(folder), "b", **(settings | faults | changes))


def rows_of(*runs):
    """Rows of (state, count) after each other, numbered."""
    state = np.concatenate([np.full(count, state) for state, count in runs])
    rows = np.zeros(state.size, ROW_DTYPE)
    rows["tick"], rows["state"] = np.arange(state.size), state
    return rows


def kept(folder):
    """First and last tick of every file."""
    faults = folder / "faults"
    files = [read_blocks(path)[1] for path in recording_files(faults, "b")] if faults.exists() else []
    assert all((np.diff(block.rows["tick"]) == 1).all() for (block,) in files)
    return [(int(block.rows["tick"][0]), int(block.rows["tick"][-1])) for (block,) in files]


RUNNING = [(State.RUNNING, 100), (State.RAMP_DOWN, 30), (State.FAULT, 50)]


@pytest.mark.parametrize(
    ("runs", "expected"),
    [
        (RUNNING, [(80, 130)]),  # the ramp takes longer than what is kept after its begin
        ([(State.RUNNING, 100), (State.RAMP_DOWN, 5), (State.FAULT, 50)], [(80, 119)]),
        ([(State.RUNNING, 100), (State.FAULT, 50)], [(80, 119)]),
        ([(State.RUNNING, 5), (State.FAULT, 3)], [(0, 7)]),  # the end of the run comes first
        ([(State.RUNNING, 100), (State.RAMP_DOWN, 30), (State.DISARMED, 50)], []),
        ([*RUNNING, (State.DISARMED, 9), (State.RUNNING, 60), (State.FAULT, 40)], [(80, 130), (229, 268)]),
        ([(State.RUNNING, 50), (State.FAULT, 2), (State.DISARMED, 2), (State.FAULT, 60)], [(30, 69), (34, 73)]),
    ],
)
@given(data=st.data())
def test_the_same_rows_are_kept_whatever_the_blocks_are(tmp_path_factory, runs, expected, data):
    folder, rows = tmp_path_factory.mktemp("kept"), rows_of(*runs)
    files, first = FaultFiles(plan_of(folder)), 0
    while first < rows.size:
        count = data.draw(st.integers(1, 90))
        files.add(Block(rows[first : first + count], first), ABOUT)
        assert files._rows.size <= 2 * AROUND + 30 + 90, "the memory is bounded"
        first += count
    files.finish(ABOUT)
    assert kept(folder) == expected


def test_rows_before_a_gap_are_forgotten(tmp_path):
    files, rows = FaultFiles(plan_of(tmp_path)), rows_of((State.RUNNING, 100), (State.FAULT, 40))
    files.add(Block(rows[:50], 0), ABOUT)
    files.add(Block(rows[90:], 90), ABOUT)
    assert kept(tmp_path) == [(90, 119)]


def test_together_they_take_no_more_than_one_file_of_the_recorder(tmp_path):
    files, noise = FaultFiles(plan_of(tmp_path, file_bytes=40_000)), np.random.default_rng(0)
    for k in range(20):
        rows = rows_of((State.RUNNING, 100), (State.FAULT, 40))
        rows["force_N"], rows["reference_N"] = noise.normal(size=(2, rows.size))
        files.add(Block(rows, k * rows.size), ABOUT)
    sizes = [path.stat().st_size for path in recording_files(tmp_path / "faults", "b")]
    assert 1 < len(sizes) < 20
    assert sum(sizes[:-1]) <= 40_000


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "No space left"), sqlite3.OperationalError("disk I/O error")])
def test_a_disk_that_fails_is_reported_and_every_tick_is_still_recorded(tmp_path, monkeypatch, error):
    def failing(*_):
        raise error

    faults = {"rows_around_fault": 5, "ramp_down": 4, "fault": 5}
    bench = Bench(tmp_path, **faults)
    monkeypatch.setattr(fault_files, "RecordingFile", failing)
    state = {"fault": False}

    def tick(count):
        for k in range(bench.written, bench.written + count):
            bench.ring_log.append(k, k, *np.zeros(6), 7, 8, 5 if state["fault"] else 2, 0, 0, 1)
        bench.written += count

    tick(100)
    bench.step()
    state["fault"] = True
    tick(50)
    report = bench.step()
    assert f"no file of the ticks around a fault: {error.args[-1]}" in report.problem
    assert (report.row, report.failures) == (150, 0)
    bench.recorder.finish()
    assert bench.recorded() == list(range(150))
