"""One program at a time drives a bench."""

import multiprocessing
import os
import time

import pytest

from piezod.errors import BusyError, ConfigurationError
from piezod.session.lock import BenchLock


def hold(lock, pipe):
    """A child that holds what it was given until told to end."""
    pipe.send("held")
    pipe.recv()
    lock.close()


def test_a_second_holder_is_refused_and_told_who_the_first_is(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    with pytest.raises(BusyError, match=f"process {os.getpid()} drives or watches this bench") as caught:
        BenchLock(tmp_path / "x.lock")
    assert caught.value.exit_code == 75
    lock.close()


def test_a_file_left_behind_is_no_lock(tmp_path):
    (tmp_path / "x.lock").write_text("999999\n")
    BenchLock(tmp_path / "x.lock").close()
    BenchLock(tmp_path / "x.lock").close()


def test_the_file_goes_with_its_holder(tmp_path):
    BenchLock(tmp_path / "x.lock").close()
    assert not (tmp_path / "x.lock").exists()


def test_a_holder_that_lets_go_in_time_is_waited_for(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=hold, args=(lock, theirs))
    child.start()
    assert ours.recv() == "held"
    os.close(lock._descriptor)  # as if this process had been killed
    with pytest.raises(BusyError):
        BenchLock(tmp_path / "x.lock")
    begun = time.monotonic()
    ours.send("end")
    BenchLock(tmp_path / "x.lock", wait_s=20.0).close()
    assert time.monotonic() - begun < 20.0
    child.join()


def test_a_lock_dies_with_its_holder(tmp_path):
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
def test_what_is_no_file_is_refused(tmp_path, make):
    path = tmp_path / "x.lock"
    {"link": lambda: path.symlink_to("/etc/passwd"), "folder": path.mkdir, "fifo": lambda: os.mkfifo(path)}[make]()
    with pytest.raises(ConfigurationError, match=r"x\.lock"):
        BenchLock(path)
