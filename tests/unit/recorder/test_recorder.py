"""The recorder in this process: what it keeps, what it drops, and how it comes back when disk or file do not."""

import errno
import json
import os
import shutil
import sqlite3

import numpy as np
import pytest

from piezod.recorder import writer as room
from piezod.recorder.segment_files import Segment, segments
from piezod.recorder.writer import Inbox, Plan, Recorder, Report, report_of, tell_on
from piezod.recording.ring_log import RingLog
from tests.benches.recorded_blocks import read_blocks
from tests.unit.recording.test_ring_log import row


class Bench:
    """A ring log that is written by hand, and a recorder that follows it."""

    def __init__(self, folder, capacity=10_000, **changes):
        self.folder = folder / "kept"
        self.path = folder / "ring"
        self.ring = RingLog(self.path, capacity)
        self.written = 0
        plan = {"sync_every_s": 0.5, "file_bytes": 1e9, "file_s": 1e9, "folder_bytes": 1e12} | changes
        self.plan = Plan(str(self.folder), "b", **plan)
        self.start()

    def start(self, session="one"):
        self.recorder = Recorder(self.plan)
        self.recorder.follow(self.path, session)
        return self.recorder

    def restarted(self, session):
        """A new control process: its ring begins again."""
        self.ring.close()
        self.ring = RingLog(self.path, 10_000)
        self.written = 0
        self.recorder.follow(self.path, session)

    def tick(self, count):
        for k in range(self.written, self.written + count):
            self.ring.append(*row(k))
        self.written += count

    def noisy_tick(self, count):
        """Ticks that cannot be packed well."""
        values = np.random.default_rng(self.written).normal(size=(count, 6))
        for k in range(count):
            self.ring.append(self.written + k, self.written + k, *values[k], 7, 8, 2, 0, 0, 1)
        self.written += count

    def step(self):
        self.recorder._retry_at_s = 0.0
        self.recorder.step()
        return self.recorder.report

    def kept(self):
        """Ticks in the files, in their order; every block sound."""
        found = [read_blocks(path) for path in segments(self.folder, "b")]
        assert all(damaged == 0 for _, _, damaged in found)
        return [int(tick) for _, blocks, _ in found for block in blocks for tick in block.rows["tick"]]


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_every_tick_is_kept_once_and_reported_when_it_is_on_the_disk(bench):
    assert bench.step() == Report(session="one", cpu_s=bench.recorder.report.cpu_s)
    for count in (10, 0, 1, 20_000 - 11):
        bench.tick(count)
        report = bench.step()
    assert (report.row, report.tick) == (20_000, 19_999)
    assert report.dropped + report.rows == 20_000
    assert bench.kept()[:11] == list(range(11))
    bench.recorder.finish()
    assert len(bench.kept()) == report.rows == report.file_rows
    assert [path.name for path in bench.folder.iterdir()] == ["b-000001.sqlite"]


def test_what_the_ring_had_to_overwrite_is_counted_once(tmp_path, monkeypatch):
    bench = Bench(tmp_path, capacity=100)
    bench.tick(10)
    bench.step()
    monkeypatch.setattr(Segment, "commit", failing(OSError(errno.ENOSPC, "No space left on device")))
    for _ in range(5):
        bench.tick(150)
        report = bench.step()
    assert report.problem.endswith("No space left on device")
    assert report.dropped == 760 - 10 - 99
    monkeypatch.undo()
    report = bench.step()
    assert report.problem == ""
    assert bench.kept() == [*range(10), *range(661, 760)]
    assert report.dropped + report.rows == 760


def failing(error):
    def fail(*_):
        raise error

    return fail


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EIO, "Input/output error"),
        OSError(errno.EROFS, "Read-only file system"),
        sqlite3.OperationalError("disk I/O error"),
        sqlite3.DatabaseError("database disk image is malformed"),
    ],
)
def test_after_an_error_ticks_go_on_in_a_new_file_and_none_is_lost(bench, monkeypatch, error):
    bench.tick(100)
    bench.step()
    monkeypatch.setattr(Segment, "commit", failing(error))
    bench.tick(100)
    report = bench.step()
    assert str(error.args[-1]) in report.problem
    assert str(bench.folder / "b-000001.sqlite") in report.problem
    assert report.row == 100
    monkeypatch.undo()
    bench.tick(100)
    report = bench.step()
    assert (report.problem, report.row, report.failures) == ("", 300, 1)
    bench.recorder.finish()
    assert bench.kept() == list(range(300))
    assert len(segments(bench.folder, "b")) == 2


def test_what_only_seems_to_be_there_after_a_failed_sync_is_written_again(bench, monkeypatch):
    """A commit whose sync failed can be read, and is lost with the power all the same."""
    bench.tick(100)
    bench.step()
    commit = Segment.commit

    def unsynced(self, block):
        commit(self, block)
        raise OSError(errno.EIO, "Input/output error")

    bench.tick(50)
    monkeypatch.setattr(Segment, "commit", unsynced)
    assert bench.step().row == 100
    monkeypatch.setattr(Segment, "commit", failing(OSError(errno.EIO, "Input/output error")))
    assert bench.step().row == 100
    monkeypatch.undo()
    report = bench.step()
    assert (report.row, report.rows) == (150, 150)
    assert [tick for path in segments(bench.folder, "b")[1:] for tick in ticks_of(path)] == list(range(100, 150))


def ticks_of(path):
    return [int(tick) for block in read_blocks(path)[1] for tick in block.rows["tick"]]


def test_a_file_whose_rows_cannot_be_brought_to_the_disk_is_not_gone_on_from(bench, monkeypatch):
    bench.tick(100)
    bench.step()
    bench.recorder.finish()
    monkeypatch.setattr(room, "sync", failing(OSError(errno.EIO, "Input/output error")))
    bench.start()
    report = bench.step()
    assert (report.row, report.problem) == (0, f"{bench.folder}: Input/output error")
    monkeypatch.undo()
    assert bench.step().row == 100


def test_retries_become_rarer_and_begin_again_at_once_after_a_success(bench, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(room.time, "monotonic", lambda: clock[0])
    tries = []
    monkeypatch.setattr(Segment, "__init__", lambda *_: tries.append(clock[0]) or failing(OSError(5, "no"))())
    bench.tick(10)
    for k in range(60):
        clock[0] = 0.25 * k
        bench.recorder.step()
    assert tries == [0.0, 0.25, 0.75, 1.75, 3.75, 8.75, 13.75]


def test_a_folder_that_is_removed_is_made_again_and_nothing_that_is_left_is_lost(bench):
    bench.tick(100)
    bench.step()
    shutil.rmtree(bench.folder)
    bench.tick(100)
    bench.step()
    bench.tick(1)
    report = bench.step()
    assert (report.problem, report.row) == ("", 201)
    assert bench.kept() == list(range(100, 201))


def test_a_folder_in_which_nothing_can_be_made_is_said_and_waited_for(tmp_path):
    (tmp_path / "kept").write_text("no folder")
    bench = Bench(tmp_path)
    bench.tick(50)
    assert bench.step().problem == f"{bench.folder}: Not a directory"
    (tmp_path / "kept").unlink()
    assert bench.step().problem == ""
    assert bench.kept() == list(range(50))


def test_a_file_moved_away_by_log_rotation_ends_there_and_a_new_one_begins(bench, tmp_path):
    bench.tick(100)
    bench.step()
    for suffix in ("", "-wal", "-shm"):
        (bench.folder / f"b-000001.sqlite{suffix}").rename(tmp_path / f"moved.sqlite{suffix}")
    bench.tick(100)
    bench.step()
    report = bench.step()
    assert report.problem == ""
    assert report.row == 200
    bench.recorder.finish()
    assert set(bench.kept()) >= set(range(100, 200))


def test_a_recorder_that_was_killed_is_followed_by_one_that_goes_on_after_its_last_tick(bench):
    bench.tick(100)
    bench.step()
    del bench.recorder._segment  # nothing is closed: what a kill leaves
    bench.tick(100)
    bench.start()
    report = bench.step()
    assert (report.row, report.rows, report.dropped) == (200, 100, 0)
    assert bench.kept() == list(range(200))
    origins = {read_blocks(path)[0].origin_ns for path in segments(bench.folder, "b")}
    assert len(origins) == 1, "time goes on from file to file"


def test_every_control_process_has_files_of_its_own_and_the_end_of_the_one_before_is_kept(bench):
    bench.tick(100)
    bench.step()
    bench.tick(50)
    bench.restarted("two")
    bench.tick(30)
    bench.step()
    bench.recorder.finish()
    assert bench.kept() == [*range(150), *range(30)]
    assert [read_blocks(path)[0].session for path in segments(bench.folder, "b")] == ["one", "two"]


def test_files_are_rotated_and_their_sum_stays_within_what_is_allowed(tmp_path):
    bench = Bench(tmp_path, capacity=20_000, file_bytes=5e6, folder_bytes=12e6)
    most = 0
    for _ in range(20):
        bench.noisy_tick(16_000)
        report = bench.step()
        most = max(most, sum(path.stat().st_size for path in bench.folder.iterdir()))
    bench.recorder.finish()
    files = segments(bench.folder, "b")
    kept = bench.kept()
    assert most <= 12e6
    assert files[0].name > "b-000001.sqlite"
    assert kept == list(range(kept[0], 320_000))
    assert report.dropped == 0
    assert report.bytes <= 12e6


def test_a_file_of_age_is_followed_by_a_new_one(tmp_path):
    bench = Bench(tmp_path, file_s=0.0)
    for _ in range(3):
        bench.tick(10)
        bench.step()
    assert len(segments(bench.folder, "b")) == 3
    assert bench.kept() == list(range(30))


def test_what_cannot_be_kept_at_the_end_is_counted_as_lost(bench, monkeypatch):
    bench.tick(10)
    bench.step()
    monkeypatch.setattr(Segment, "commit", failing(OSError(errno.ENOSPC, "full")))
    bench.tick(5)
    bench.recorder.finish()
    assert bench.recorder.report.dropped == 5


def test_messages_come_in_pieces_and_reports_go_as_lines():
    ours, theirs = os.pipe()
    inbox = Inbox(ours)
    os.write(theirs, b'{"ring": "/r", "ses')
    assert list(inbox.wait(0.0)) == []
    os.write(theirs, b'sion": "s"}\n{"end": true}\n')
    assert list(inbox.wait(0.0)) == [{"ring": "/r", "session": "s"}, {"end": True}]
    assert list(inbox.wait(0.0)) == []
    assert not inbox.closed
    os.close(theirs)
    assert list(inbox.wait(0.0)) == []
    assert inbox.closed
    os.close(ours)
    ours, theirs = os.pipe()
    tell = tell_on(theirs)
    report = Report("s", 3, 2, "f", 3, 3, 0, 0, "", 4096, 0.5, 1.5, 0.1)
    for _ in range(10_000):  # nobody reads: it does not wait
        tell(report)
    assert report_of(os.read(ours, 65536).splitlines()[0]) == report
    os.close(ours)
    os.close(theirs)
    tell(report)
    assert json.loads(json.dumps(report.__dict__))["row"] == 3
