"""The lock lets one program at a time use a bench."""

import multiprocessing
import os
import time

import pytest

from piezod.errors import BusyError, ConfigurationError
from piezod.session.lock import BenchLock


def hold(lock, pipe):
    """Hold the lock in a child process until a message arrives."""
    pipe.send("held")
    pipe.recv()
    lock.close()


def test_a_second_holder_is_refused_with_the_process_of_the_first(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    with pytest.raises(BusyError, match=f"process {os.getpid()} drives or watches this bench") as caught:
        BenchLock(tmp_path / "x.lock")
    assert caught.value.exit_code == 75
    lock.close()


def test_a_file_without_a_holder_does_not_lock(tmp_path):
    (tmp_path / "x.lock").write_text("999999\n")
    BenchLock(tmp_path / "x.lock").close()
    BenchLock(tmp_path / "x.lock").close()


def test_close_removes_the_file(tmp_path):
    BenchLock(tmp_path / "x.lock").close()
    assert not (tmp_path / "x.lock").exists()


def test_a_lock_that_is_released_in_time_is_acquired(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=hold, args=(lock, theirs))
    child.start()
    assert ours.recv() == "held"
    os.close(lock._descriptor)  # the state after this process was killed
    with pytest.raises(BusyError):
        BenchLock(tmp_path / "x.lock")
    begun = time.monotonic()
    ours.send("end")
    BenchLock(tmp_path / "x.lock", wait_s=20.0).close()
    assert time.monotonic() - begun < 20.0
    child.join()


def test_the_end_of_the_last_holder_releases_the_lock(tmp_path):
    context = multiprocessing.get_context("spawn")
    lock = BenchLock(tmp_path / "x.lock")
    ours, theirs = context.Pipe()
    child = context.Process(target=hold, args=(lock, theirs))
    child.start()
    assert ours.recv() == "held"
    os.close(lock._descriptor)
    child.kill()
    child.join()
    BenchLock(tmp_path / "x.lock").close()


@pytest.mark.parametrize("make", ["link", "folder", "fifo"])
def test_a_path_that_is_not_a_regular_file_is_refused(tmp_path, make):
    path = tmp_path / "x.lock"
    {"link": lambda: path.symlink_to("/etc/passwd"), "folder": path.mkdir, "fifo": lambda: os.mkfifo(path)}[make]()
    with pytest.raises(ConfigurationError, match=r"x\.lock"):
        BenchLock(path)
