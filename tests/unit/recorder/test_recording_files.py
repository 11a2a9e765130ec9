"""Files of the recorder: numbers, size limit, closing, and files that another program moved or replaced."""

import contextlib
import os
import sqlite3
import stat
import threading

import numpy as np
import pytest

from piezod.errors import RecordingError
from piezod.recorder.recording_files import (
    RecordingFile,
    _new_file,
    make_room,
    recording_files,
    size_bytes,
    tidy_files,
)
from piezod.recording import read_recording
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import About
from piezod.recording.ring_log import ROW_DTYPE
from tests.benches.recorded_blocks import begun_files, read_blocks
from tests.unit.recording.test_sqlite import ticks

ABOUT = About(ROW_DTYPE, "ticks", {"bench": "b"}, "session", 10**9)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_numbers_increase_whatever_the_clock_is_and_each_bench_has_its_own(tmp_path):
    for bench in ("b", "b-2", "b"):
        file = RecordingFile(tmp_path, bench, ABOUT)
        file.commit(Block(ticks(10)))
        file.close()
    os.utime(tmp_path / "b-000001.sqlite", (2e9, 2e9))
    assert [path.name for path in recording_files(tmp_path, "b")] == ["b-000001.sqlite", "b-000002.sqlite"]
    assert [path.name for path in recording_files(tmp_path, "b-2")] == ["b-2-000001.sqlite"]
    (tmp_path / "b-1000000.sqlite").touch()
    (tmp_path / "b-x.sqlite").touch()
    assert [path.name for path in recording_files(tmp_path, "b")][-1] == "b-1000000.sqlite"


def test_a_closed_file_has_no_other_parts_and_a_file_without_ticks_is_removed(tmp_path):
    file = RecordingFile(tmp_path, "b", ABOUT)
    file.commit(Block(ticks(10)))
    assert names(tmp_path) == ["b-000001.sqlite", "b-000001.sqlite-shm", "b-000001.sqlite-wal"]
    file.close()
    RecordingFile(tmp_path, "b", ABOUT).close()
    assert names(tmp_path) == ["b-000001.sqlite"]


def test_a_file_that_a_kill_left_before_its_first_block_says_so(tmp_path):
    file = RecordingFile(tmp_path, "b", ABOUT)
    with pytest.raises(RecordingError, match="the recorder was ended before it wrote the first block"):
        read_recording(file.path)
    assert begun_files(tmp_path, "b") == []
    file.commit(Block(ticks(10)))
    assert begun_files(tmp_path, "b") == [file.path]
    file.close()


@pytest.mark.parametrize("suffix", ["", "-wal"])
@pytest.mark.parametrize("act", ["removed", "replaced"])
def test_a_commit_to_a_file_that_was_removed_or_replaced_fails(tmp_path, suffix, act):
    file = RecordingFile(tmp_path, "b", ABOUT)
    file.commit(Block(ticks(10)))
    gone = file.path.with_name(file.path.name + suffix)
    gone.rename(tmp_path / "rotated")
    if act == "replaced":
        gone.touch()
    with pytest.raises((OSError, sqlite3.Error)):
        file.commit(Block(ticks(10, 10), 10))
    file.close()


def test_files_of_a_crash_are_joined_and_empty_files_are_removed(tmp_path):
    file = RecordingFile(tmp_path, "b", ABOUT)
    file.commit(Block(ticks(10)))
    crashed = tmp_path / "b-000007.sqlite"
    for suffix in ("", "-wal"):
        crashed.with_name(crashed.name + suffix).write_bytes((tmp_path / f"b-000001.sqlite{suffix}").read_bytes())
    (tmp_path / "b-000008.sqlite").touch()
    tidy_files(recording_files(tmp_path, "b"))
    assert (tmp_path / "b-000001.sqlite-wal").exists(), "still being written"
    file.commit(Block(ticks(10, 10), 10))
    file.close()
    assert names(tmp_path) == ["b-000001.sqlite", "b-000007.sqlite"]
    assert [sum(block.rows.size for block in read_blocks(tmp_path / name)[1]) for name in names(tmp_path)] == [20, 10]


def test_the_files_with_the_lowest_numbers_are_removed_first(tmp_path):
    for k in range(1, 6):
        (tmp_path / f"b-00000{k}.sqlite").write_bytes(bytes(1000))
    (tmp_path / "b-000001.sqlite-wal").write_bytes(bytes(500))
    assert make_room(recording_files(tmp_path, "b"), 2500) == 2000
    assert names(tmp_path) == ["b-000004.sqlite", "b-000005.sqlite"]


def test_closing_takes_no_more_than_the_margin(tmp_path):
    rng = np.random.default_rng(1)
    rows = ticks(16_384)
    rows["force_N"], rows["planned_V"], rows["voltage_V"] = rng.normal(size=(3, rows.size))
    file = RecordingFile(tmp_path, "b", ABOUT)
    for k in range(8):
        file.commit(Block(rows, k * rows.size))
    allowed, seen, closed = file.bytes, [], threading.Event()
    watch = threading.Thread(target=lambda: [seen.append(size_bytes(file.path)) for _ in iter(closed.is_set, True)])
    watch.start()
    file.close()
    closed.set()
    watch.join()
    assert max(seen) <= allowed
    assert size_bytes(file.path) > 2e6


def test_a_file_of_another_program_with_such_a_name_is_neither_removed_nor_counted(tmp_path):
    (tmp_path / "b-000001.sqlite").write_bytes(b"precious" * 1000)
    with contextlib.closing(sqlite3.connect(tmp_path / "b-000002.sqlite")) as other:
        other.execute("CREATE TABLE mine (x)")
        other.commit()
    (tmp_path / "b-000002.sqlite-wal").write_bytes(b"")
    files = recording_files(tmp_path, "b")
    tidy_files(files)
    assert make_room(files, 0) == 0
    assert [path.exists() for path in files] == [True, True]


def test_a_file_has_its_mode_whatever_the_umask_is(tmp_path):
    for umask in (0o000, 0o077):
        before = os.umask(umask)
        try:
            path = _new_file(tmp_path, "b")
        finally:
            os.umask(before)
        assert stat.S_IMODE(path.stat().st_mode) == 0o640


@pytest.mark.parametrize(
    "statements",
    [
        [],
        ["CREATE TABLE mine (x)"],
        ["PRAGMA page_size = 65536", "CREATE TABLE mine (x)"],
        ["CREATE TABLE t (x)", "DROP TABLE t"],
        ["PRAGMA journal_mode = WAL", "CREATE TABLE mine (x)"],
        ["PRAGMA application_id = 1", "PRAGMA user_version = 3"],
    ],
)
def test_a_database_of_somebody_else_stays_in_a_full_folder(tmp_path, statements):
    path = tmp_path / "b-000001.sqlite"
    other = sqlite3.connect(path, isolation_level=None)
    for statement in statements or ["PRAGMA user_version = 7"]:
        other.execute(statement)
    before = path.read_bytes()
    tidy_files(recording_files(tmp_path, "b"))
    make_room(recording_files(tmp_path, "b"), 0)
    assert path.read_bytes() == before
    other.close()


def test_a_file_that_a_kill_left_before_its_first_block_is_still_tidied(tmp_path):
    path = tmp_path / "b-000001.sqlite"
    begun = RecordingFile(tmp_path, "b", ABOUT)
    head = path.read_bytes()
    begun.close()
    path.write_bytes(head)
    assert head
    tidy_files([path])
    assert not path.exists()
