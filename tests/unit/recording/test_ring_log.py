"""The ring log: one writer, several readers, no incomplete row."""

import errno
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.errors import ConfigurationError, TemporaryError, UnreachableError
from piezod.recording.ring_log import COUNTERS, ROW_DTYPE, RingLog, RingReader, remove_ring_log


def row(k):
    return (k, 10 * k, float(k), 2.0, 3.0, 4.0, 5.0, 6.0, 7, 8, 2, 0, 0, 1)


def test_appended_rows_are_read_once_and_in_order(tmp_path):
    log = RingLog(tmp_path / "ring", 100)
    reader = RingReader(tmp_path / "ring")
    for k in range(30):
        log.append(*row(k))
    first = reader.read()
    log.append(*row(30))
    assert list(first["tick"]) == list(range(30))
    assert list(reader.read()["tick"]) == [30]
    assert tuple(first[7])[:3] == (7, 70, 7.0)
    log.close()


def test_a_late_reader_counts_the_rows_that_were_overwritten(tmp_path):
    log = RingLog(tmp_path / "ring", 10)
    reader = RingReader(tmp_path / "ring")
    for k in range(25):
        log.append(*row(k))
    ticks = list(reader.read()["tick"])
    assert ticks == list(range(25 - len(ticks), 25))
    assert reader.dropped == 25 - len(ticks)
    assert len(ticks) >= 9
    log.close()


def test_seek_reads_rows_again_and_most_limits_the_rows_of_a_read(tmp_path):
    log = RingLog(tmp_path / "ring", 10)
    for k in range(8):
        log.append(*row(k))
    reader = RingReader(tmp_path / "ring", 3)
    assert list(reader.read(2)["tick"]) == [3, 4]
    reader.seek(3)
    assert reader.next == 3
    assert list(reader.read(4)["tick"]) == [3, 4, 5, 6]
    for k in range(8, 20):
        log.append(*row(k))
    assert reader.dropped == 0
    assert list(reader.read()["tick"]) == list(range(11, 20))
    assert (reader.dropped, reader.next) == (4, 20)
    log.close()


def test_a_reader_beside_the_writer_never_sees_an_incomplete_row(tmp_path):
    log = RingLog(tmp_path / "ring", 64)
    reader = RingReader(tmp_path / "ring")
    total = 100_000
    writer = threading.Thread(target=lambda: [log.append(*row(k)) for k in range(total)])
    writer.start()
    seen = 0
    last = -1
    while writer.is_alive() or last < total - 1:
        rows = reader.read()
        if rows.size:
            assert (rows["time_ns"] == 10 * rows["tick"]).all()
            assert (rows["reference_N"] == rows["tick"]).all()
            assert rows["tick"][0] > last
            assert (np.diff(rows["tick"]) == 1).all()
            last = int(rows["tick"][-1])
            seen += rows.size
    writer.join()
    assert seen + reader.dropped == total
    log.close()


FOLLOW = """
import sys
from pathlib import Path
import numpy as np
from piezod.recording.ring_log import RingReader
reader = RingReader(Path(sys.argv[1]))
print("following", flush=True)
at, total = 0, int(sys.argv[2])
while at < total:
    ticks = reader.read()["tick"]
    if ticks.size:
        assert ticks[0] == at and (np.diff(ticks) == 1).all(), f"{ticks[0]} after {at - 1}"
        at = int(ticks[-1]) + 1
print(reader.dropped)
"""


def test_a_reader_in_another_process_never_sees_an_incomplete_count(tmp_path):
    total = 300_000
    log = RingLog(tmp_path / "ring", total + 1)
    command = [sys.executable, "-c", FOLLOW, str(tmp_path / "ring"), str(total)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as reader:
        assert reader.stdout.readline() == "following\n"
        for k in range(total):
            log.append(*row(k))
        out, err = reader.communicate(timeout=60)
    log.close()
    assert (out, err) == ("0\n", "")


def test_a_missing_ring_and_a_foreign_file_are_refused(tmp_path):
    (tmp_path / "other").write_bytes(b"x" * 200)
    with pytest.raises(UnreachableError, match="is the daemon running"):
        RingReader(tmp_path / "none")
    with pytest.raises(UnreachableError, match="not a ring log"):
        RingReader(tmp_path / "other")


@pytest.mark.parametrize("content", [b"precious", b"PIEZ"])
def test_a_file_that_is_no_ring_log_is_neither_replaced_nor_removed(tmp_path, content):
    path = tmp_path / "ring"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError, match="was not made by piezod"):
        RingLog(path, 10)
    remove_ring_log(path)
    assert path.read_bytes() == content


def test_a_link_to_a_ring_log_is_not_followed(tmp_path):
    RingLog(tmp_path / "other", 10).close()
    (tmp_path / "ring").symlink_to(tmp_path / "other")
    with pytest.raises(ConfigurationError, match="not a regular file"):
        RingLog(tmp_path / "ring", 10)
    assert (tmp_path / "ring").is_symlink()


def test_an_earlier_ring_log_is_replaced_and_removed(tmp_path):
    for _ in range(2):
        RingLog(tmp_path / "ring", 10).close()
    remove_ring_log(tmp_path / "ring")
    assert list(tmp_path.iterdir()) == []


def test_a_full_file_system_is_temporary_and_leaves_no_file(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(TemporaryError, match=r"No space left.*lower daemon\.ring_seconds") as caught:
        RingLog(tmp_path / "ring", 10_000)
    assert caught.value.exit_code == 75
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_the_file_has_its_mode_whatever_the_umask_is(tmp_path, umask):
    before = os.umask(umask)
    try:
        RingLog(tmp_path / "ring", 10).close()
    finally:
        os.umask(before)
    assert (tmp_path / "ring").stat().st_mode & 0o777 == 0o640


def test_counters_reach_the_reader_and_a_log_without_a_file_holds_rows(tmp_path):
    log = RingLog(tmp_path / "ring", 10)
    reader = RingReader(tmp_path / "ring")
    log.counters[2] += 7
    log.append(*row(0))
    assert reader.counters == (0, 0, 7, *[0] * (COUNTERS - 3))
    log.close()
    memory = RingLog(None, 10)
    memory.append(*row(1))
    memory.close()


def test_a_ring_log_of_an_earlier_version_has_no_counters(tmp_path):
    RingLog(tmp_path / "ring", 10).close()
    with (tmp_path / "ring").open("r+b") as file:
        file.truncate(32 + 10 * (ROW_DTYPE.itemsize + 8))
    assert RingReader(tmp_path / "ring").counters == ()


def test_an_empty_file_that_a_truncated_ring_log_left_is_replaced(tmp_path):
    (tmp_path / "ring").touch()
    RingLog(tmp_path / "ring", 10).close()
    assert not RingReader(tmp_path / "ring").is_broken


@pytest.mark.parametrize("size", [0, 10, 500])
def test_writer_and_reader_survive_a_file_that_is_truncated(tmp_path, size):
    path = tmp_path / "ring"
    log = RingLog(path, 1000)
    for k in range(20):
        log.append(*row(k))
    reader = RingReader(path, first=10)
    assert not reader.is_broken
    os.truncate(path, size)
    assert reader.is_broken
    log.append(*row(20))
    reader.read()
    assert reader.counters == () or len(reader.counters) == COUNTERS
    log.restore()
    log.append(*row(21))
    fresh = RingReader(path)
    assert fresh.read()["tick"].tolist() == [21]
    log.close()


@given(size=st.integers(0, 32 + 20 * 104), later=st.integers(1, 25))
def test_a_reader_gives_only_whole_rows_of_a_file_that_was_cut_anywhere_and_written_on(size, later):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ring"
        log = RingLog(path, 20)
        for k in range(1, 16):
            log.append(*row(k))
        reader = RingReader(path)
        os.truncate(path, size)
        for k in range(16, 16 + later):
            log.append(*row(k))
        rows = reader.read()
        log.close()
    assert [tuple(found) for found in rows] == [row(k) for k in rows["tick"]]
    lost = 15 + later - rows.size
    assert reader.dropped == lost
    assert rows["tick"][-1] == 15 + later


@pytest.mark.parametrize("how", ["removed", "replaced"])
def test_a_file_that_is_removed_or_replaced_is_noticed_and_made_again(tmp_path, how):
    path = tmp_path / "ring"
    log = RingLog(path, 10)
    reader = RingReader(path)
    path.unlink()
    if how == "replaced":
        path.touch()
    assert reader.is_broken
    log.restore()
    assert not RingReader(path).is_broken
    log.close()


def test_rows_that_cannot_be_written_are_counted(tmp_path):
    log = RingLog(tmp_path / "ring", 10)
    descriptor, log._descriptor = log._descriptor, os.open(tmp_path / "ring", os.O_RDONLY)
    log.append(*row(0))
    assert log.lost == 1
    os.close(log._descriptor)
    log._descriptor = descriptor
    log.close()
