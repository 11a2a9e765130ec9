"""A driven bench whose run-time files somebody removes or truncates, and whose log nobody reads."""

import os
import shutil

import pytest

from piezod.config import load_bench
from piezod.errors import BusyError, UnreachableError
from piezod.recording.ring_log import RingReader
from piezod.session.lock import BenchLock, lock_bench
from tests.benches.daemon import LONG_LIMITS, WITHIN_S, daemon, until
from tests.benches.emulator import bench_file, emulator

pytestmark = pytest.mark.slow  # rows D11 to D14 of the fault list run them by name


@pytest.fixture
def driven(tmp_path):
    reference = {"kind": "triangle", "amplitude_N": 1.0, "offset_N": 100.0, "frequency_Hz": 0.5}
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=100.0, limits=LONG_LIMITS, reference=reference)
        with daemon(bench) as running:
            running.connected()
            running.tell("arm")
            yield running
            assert running.end() == 0


def is_readable(ring):
    try:
        reader = RingReader(ring)
    except UnreachableError:
        return False
    return not reader.is_broken and reader.read().size > 0


@pytest.mark.parametrize("how", ["truncated", "removed", "cut in half"])
def test_a_ring_log_is_made_again_and_the_bench_drives_on(driven, how):
    size = driven.ring.stat().st_size
    if how == "removed":
        driven.ring.unlink()
    else:
        os.truncate(driven.ring, 0 if how == "truncated" else size // 2)
    driven.wait_for("ring log of the daemon; made again")
    until(lambda: is_readable(driven.ring))
    assert driven.status()["state"] == "RUNNING"


def test_removed_sockets_and_locks_are_made_again_and_keep_out_a_second_program(driven):
    config = load_bench(driven.bench)
    for path in (config.socket_path, config.stop_socket_path, config.lock_path):
        path.unlink()
    until(lambda: all(path.exists() for path in (config.socket_path, config.stop_socket_path, config.lock_path)))
    with pytest.raises(BusyError):
        lock_bench(config)
    assert driven.status()["state"] == "RUNNING"
    assert driven.tell("disarm")["state"] == "DISARMED"


def test_a_program_that_takes_the_lock_after_its_removal_ends_the_first_one(tmp_path):
    with emulator("--port", "0") as serves:
        bench = bench_file(tmp_path, serves, rate_Hz=100.0, limits=LONG_LIMITS)
        with daemon(bench) as running:
            running.connected()
            running.tell("arm")
            path = load_bench(bench).lock_path
            path.unlink()
            lock = BenchLock(path)
            running.wait_for("another program has taken it")
            assert running.process.wait(timeout=WITHIN_S) == 0
            lock.close()


def test_a_log_that_nobody_reads_any_more_ends_nothing(driven):
    with open(os.devnull, "rb") as nothing:  # noqa: PTH123  # takes the place of the read end of the pipe
        os.dup2(nothing.fileno(), driven.process.stderr.fileno())
    for _ in range(20):
        driven.refuses("arm", "must be DISARMED")
    assert driven.status()["state"] in ("ARMING", "RUNNING")
    assert driven.tell("disarm")["state"] == "DISARMED"


def test_a_driven_bench_whose_folder_vanishes_for_good_is_ramped_down(tmp_path):
    folder = tmp_path / "ring"
    folder.mkdir()
    with emulator("--port", "0") as serves:
        section = {"ring_log": str(folder / "bench.ring")}
        bench = bench_file(tmp_path, serves, rate_Hz=100.0, limits=LONG_LIMITS, daemon=section)
        with daemon(bench) as running:
            running.ring = folder / "bench.ring"
            running.connected()
            running.tell("arm")
            shutil.rmtree(folder)
            running.wait_for("no socket can be made on which a stop would come; ramping down")
            running.wait_for("DISARMED")
            folder.mkdir()
            until(lambda: load_bench(bench).stop_socket_path.exists() and load_bench(bench).lock_path.exists())
            assert running.status()["state"] == "DISARMED"
