"""Recording in this process: recorded rows, dropped rows, and recovery from errors of disk, file and folder."""

import errno
import json
import os
import shutil
import sqlite3

import numpy as np
import pytest

from piezod.recorder import ring_recorder
from piezod.recorder.messages import MessageReader, Plan, Report, parse_report, report_sender
from piezod.recorder.recording_files import RecordingFile, recording_files
from piezod.recorder.ring_recorder import RingRecorder
from piezod.recording.ring_log import RingLog
from tests.benches.recorded_blocks import read_blocks
from tests.unit.recording.test_ring_log import row


class Bench:
    """A ring log that the test writes, and a recorder that follows it."""

    def __init__(self, folder, capacity=10_000, **changes):
        self.folder = folder / "recordings"
        self.path = folder / "ring"
        self.ring_log = RingLog(self.path, capacity)
        self.written = 0
        plan = {"sync_every_s": 0.5, "file_bytes": 1e9, "file_s": 1e9, "folder_bytes": 1e12} | changes
        self.plan = Plan(str(self.folder), "b", **plan)
        self.start()

    def start(self, session="one"):
        self.recorder = RingRecorder(self.plan)
        self.recorder.follow(self.path, session)
        return self.recorder

    def restarted(self, session):
        """Begin a new control process, which writes a new ring log."""
        self.ring_log.close()
        self.ring_log = RingLog(self.path, 10_000)
        self.written = 0
        self.recorder.follow(self.path, session)

    def tick(self, count):
        for k in range(self.written, self.written + count):
            self.ring_log.append(*row(k))
        self.written += count

    def noisy_tick(self, count):
        """Append ticks that cannot be compressed well."""
        values = np.random.default_rng(self.written).normal(size=(count, 6))
        for k in range(count):
            self.ring_log.append(self.written + k, self.written + k, *values[k], 7, 8, 2, 0, 0, 1)
        self.written += count

    def step(self):
        self.recorder._retry_at_s = 0.0
        self.recorder.step()
        return self.recorder.report

    def recorded(self):
        """Ticks in the files, in their order; no block is damaged."""
        found = [read_blocks(path) for path in recording_files(self.folder, "b")]
        assert all(damaged == 0 for _, _, damaged in found)
        return [int(tick) for _, blocks, _ in found for block in blocks for tick in block.rows["tick"]]


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)


def test_every_tick_is_recorded_once_and_reported_when_it_is_on_the_disk(bench):
    assert bench.step() == Report(session="one", cpu_s=bench.recorder.report.cpu_s)
    for count in (10, 0, 1, 20_000 - 11):
        bench.tick(count)
        report = bench.step()
    assert (report.row, report.tick) == (20_000, 19_999)
    assert report.dropped + report.rows == 20_000
    assert bench.recorded()[:11] == list(range(11))
    bench.recorder.finish()
    assert len(bench.recorded()) == report.rows
    assert [path.name for path in bench.folder.iterdir()] == ["b-000001.sqlite"]


def test_an_overwritten_row_is_counted_once(tmp_path, monkeypatch):
    bench = Bench(tmp_path, capacity=100)
    bench.tick(10)
    bench.step()
    monkeypatch.setattr(RecordingFile, "commit", failing(OSError(errno.ENOSPC, "No space left on device")))
    for _ in range(5):
        bench.tick(150)
        report = bench.step()
    assert report.problem.endswith("No space left on device")
    assert report.dropped == 760 - 10 - 99
    monkeypatch.undo()
    report = bench.step()
    assert report.problem == ""
    assert bench.recorded() == [*range(10), *range(661, 760)]
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
def test_after_an_error_a_new_file_begins_and_no_tick_is_lost(bench, monkeypatch, error):
    bench.tick(100)
    bench.step()
    monkeypatch.setattr(RecordingFile, "commit", failing(error))
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
    assert bench.recorded() == list(range(300))
    assert len(recording_files(bench.folder, "b")) == 2


def test_rows_of_a_failed_sync_are_written_again(bench, monkeypatch):
    """A commit whose sync failed can be read, but is lost in a power cut."""
    bench.tick(100)
    bench.step()
    commit = RecordingFile.commit

    def unsynced(self, block):
        commit(self, block)
        raise OSError(errno.EIO, "Input/output error")

    bench.tick(50)
    monkeypatch.setattr(RecordingFile, "commit", unsynced)
    assert bench.step().row == 100
    monkeypatch.setattr(RecordingFile, "commit", failing(OSError(errno.EIO, "Input/output error")))
    assert bench.step().row == 100
    monkeypatch.undo()
    report = bench.step()
    assert (report.row, report.rows) == (150, 150)
    assert [tick for path in recording_files(bench.folder, "b")[1:] for tick in ticks_of(path)] == list(range(100, 150))


def ticks_of(path):
    return [int(tick) for block in read_blocks(path)[1] for tick in block.rows["tick"]]


def test_a_previous_file_that_cannot_be_synchronised_is_not_continued(bench, monkeypatch):
    bench.tick(100)
    bench.step()
    bench.recorder.finish()
    monkeypatch.setattr(ring_recorder, "sync", failing(OSError(errno.EIO, "Input/output error")))
    bench.start()
    report = bench.step()
    assert (report.row, report.problem) == (0, f"{bench.folder}: Input/output error")
    monkeypatch.undo()
    assert bench.step().row == 100


def test_pauses_before_retries_grow_to_five_seconds(bench, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(ring_recorder.clock, "monotonic", lambda: clock[0])
    tries = []
    monkeypatch.setattr(RecordingFile, "__init__", lambda *_: tries.append(clock[0]) or failing(OSError(5, "no"))())
    bench.tick(10)
    for k in range(60):
        clock[0] = 0.25 * k
        bench.recorder.step()
    assert tries == [0.0, 0.25, 0.75, 1.75, 3.75, 8.75, 13.75]


def test_a_removed_folder_is_created_again_and_no_later_tick_is_lost(bench):
    bench.tick(100)
    bench.step()
    shutil.rmtree(bench.folder)
    bench.tick(100)
    bench.step()
    bench.tick(1)
    report = bench.step()
    assert (report.problem, report.row) == ("", 201)
    assert bench.recorded() == list(range(100, 201))


def test_a_folder_that_cannot_be_created_is_reported_and_retried(tmp_path):
    (tmp_path / "recordings").write_text("not a folder")
    bench = Bench(tmp_path)
    bench.tick(50)
    assert bench.step().problem == f"{bench.folder}: Not a directory"
    (tmp_path / "recordings").unlink()
    assert bench.step().problem == ""
    assert bench.recorded() == list(range(50))


def test_a_file_that_is_moved_away_ends_and_a_new_file_begins(bench, tmp_path):
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
    assert set(bench.recorded()) >= set(range(100, 200))


def test_a_new_recorder_continues_after_the_last_tick_of_a_killed_recorder(bench):
    bench.tick(100)
    bench.step()
    del bench.recorder._file  # without closing the file, as after a kill
    bench.tick(100)
    bench.start()
    report = bench.step()
    assert (report.row, report.rows, report.dropped) == (200, 100, 0)
    assert bench.recorded() == list(range(200))
    origins = {read_blocks(path)[0].origin_ns for path in recording_files(bench.folder, "b")}
    assert len(origins) == 1, "all files have one time origin"


def test_every_control_process_has_its_own_files_and_the_end_of_the_previous_one_is_recorded(bench):
    bench.tick(100)
    bench.step()
    bench.tick(50)
    bench.restarted("two")
    bench.tick(30)
    bench.step()
    bench.recorder.finish()
    assert bench.recorded() == [*range(150), *range(30)]
    assert [read_blocks(path)[0].session for path in recording_files(bench.folder, "b")] == ["one", "two"]


def test_old_files_are_removed_so_that_the_sum_stays_within_its_limit(tmp_path):
    bench = Bench(tmp_path, capacity=20_000, file_bytes=5e6, folder_bytes=12e6)
    most = 0
    for _ in range(20):
        bench.noisy_tick(16_000)
        report = bench.step()
        most = max(most, sum(path.stat().st_size for path in bench.folder.iterdir()))
    bench.recorder.finish()
    files = recording_files(bench.folder, "b")
    recorded = bench.recorded()
    assert most <= 12e6
    assert files[0].name > "b-000001.sqlite"
    assert recorded == list(range(recorded[0], 320_000))
    assert report.dropped == 0
    assert report.bytes <= 12e6


def test_a_file_at_its_age_limit_is_followed_by_a_new_file(tmp_path):
    bench = Bench(tmp_path, file_s=0.0)
    for _ in range(3):
        bench.tick(10)
        bench.step()
    assert len(recording_files(bench.folder, "b")) == 3
    assert bench.recorded() == list(range(30))


def test_rows_that_cannot_be_written_at_the_end_count_as_dropped(bench, monkeypatch):
    bench.tick(10)
    bench.step()
    monkeypatch.setattr(RecordingFile, "commit", failing(OSError(errno.ENOSPC, "full")))
    bench.tick(5)
    bench.recorder.finish()
    assert bench.recorder.report.dropped == 5


def test_messages_may_arrive_in_pieces_and_a_full_pipe_does_not_block_reports():
    ours, theirs = os.pipe()
    messages = MessageReader(ours)
    os.write(theirs, b'{"ring": "/r", "ses')
    assert list(messages.wait(0.0)) == []
    os.write(theirs, b'sion": "s"}\n{"end": true}\n')
    assert list(messages.wait(0.0)) == [{"ring": "/r", "session": "s"}, {"end": True}]
    assert list(messages.wait(0.0)) == []
    assert not messages.closed
    os.close(theirs)
    assert list(messages.wait(0.0)) == []
    assert messages.closed
    os.close(ours)
    ours, theirs = os.pipe()
    send = report_sender(theirs)
    report = Report("s", 3, 2, "f", 3, 0, 0, "", 4096, 0.5, 1.5, 0.1)
    for _ in range(10_000):  # without a reader the pipe becomes full
        send(report)
    assert parse_report(os.read(ours, 65536).splitlines()[0]) == report
    os.close(ours)
    os.close(theirs)
    send(report)
    assert json.loads(json.dumps(report.__dict__))["row"] == 3
