"""The lock lets one program at a time use a bench."""

import multiprocessing
import os
import signal
import socket
import time
from unittest.mock import MagicMock

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench, run_time_files
from piezod.config.link import SerialLineLink
from piezod.config.sections import DaemonConfig
from piezod.errors import BusyError, ConfigurationError
from piezod.runtime import sockets
from piezod.session import control_process
from piezod.session.device_names import device_names
from piezod.session.lock import BenchLock, device_lock_paths, lock_bench
from piezod.session.task import Task


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
    lock = BenchLock(tmp_path / "x.lock")
    with pytest.raises(BusyError, match=f"process {os.getpid()} "):
        BenchLock(tmp_path / "x.lock")
    lock.close()


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
    os.close(lock._held[tmp_path / "x.lock"])  # the state after this process was killed
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
    os.close(lock._held[tmp_path / "x.lock"])
    child.kill()
    child.join()
    BenchLock(tmp_path / "x.lock").close()


@pytest.mark.parametrize("make", ["link", "folder", "fifo"])
def test_a_path_that_is_not_a_regular_file_is_refused(tmp_path, make):
    path = tmp_path / "x.lock"
    {"link": lambda: path.symlink_to("/etc/passwd"), "folder": path.mkdir, "fifo": lambda: os.mkfifo(path)}[make]()
    with pytest.raises(ConfigurationError, match=r"x\.lock"):
        BenchLock(path)


@pytest.mark.parametrize("content", ["precious\n", "12 apples", "1" * 30])
def test_a_file_with_other_content_is_neither_overwritten_nor_removed(tmp_path, content):
    path = tmp_path / "x.lock"
    path.write_text(content)
    with pytest.raises(ConfigurationError, match="is no lock file"):
        BenchLock(path)
    assert path.read_text() == content


def tcp(host="127.0.0.1", port=502, unit_id=1):
    return load_bench(shipped("bench.yaml")).link.model_copy(update={"host": host, "port": port, "unit_id": unit_id})


@pytest.mark.parametrize("host", ["localhost", "127.0.0.2", "::1", "::ffff:127.0.0.1", "0.0.0.0"])
def test_every_name_of_this_machine_is_the_same_device(host):
    assert device_names(tcp(host)) == device_names(tcp())


def test_port_unit_and_address_make_another_device():
    others = (tcp(port=503), tcp(unit_id=2), tcp(unit_id=0), tcp("192.0.2.7"), tcp("192.0.2.8"))
    assert len({device_names(tcp()), *map(device_names, others)}) == 6
    assert device_names(tcp(unit_id=0)) == device_names(tcp(unit_id=255))


def test_a_name_counts_by_its_addresses(monkeypatch):
    found = {"a.example": ["192.0.2.7"], "b.example": ["192.0.2.8", "192.0.2.7"]}

    def resolve(host, port, **_):
        return [(socket.AF_INET, socket.SOCK_STREAM, 0, "", (one, port)) for one in found[host]]

    monkeypatch.setattr(sockets, "getaddrinfo", resolve)
    assert set(device_names(tcp("a.example"))) < set(device_names(tcp("b.example")))


def test_links_to_a_serial_port_are_the_same_device(tmp_path):
    master, slave = os.openpty()
    try:
        (tmp_path / "by-id").symlink_to(os.ttyname(slave))
        config = SerialLineLink(kind="serial_line", port=os.ttyname(slave))
        by_id = config.model_copy(update={"port": str(tmp_path / "by-id")})
        assert device_names(by_id) == device_names(config)
    finally:
        os.close(master)
        os.close(slave)
    assert device_names(config.model_copy(update={"port": "/dev/none"})) == ("serial /dev/none",)


def error_of_control_process(task, lock, monkeypatch):
    """Message of a control process that ends at its start; it runs in this process."""
    for name in ("processes", "signals", "gc"):
        monkeypatch.setattr(control_process, name, MagicMock(), raising=False)
    pipe = MagicMock()
    control_process.run(task, pipe, lock, None)
    return pipe.send.call_args[0][0]


def test_two_bench_files_of_one_device_exclude_each_other_and_a_started_process_checks_again(tmp_path, monkeypatch):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    first, second = (
        load_bench(shipped("bench.yaml")).model_copy(
            update={"daemon": DaemonConfig(ring_log=str(tmp_path / name)), "link": tcp(host)}
        )
        for name, host in (("a", "127.0.0.1"), ("b", "localhost"))
    )
    lock = lock_bench(first)
    with pytest.raises(BusyError, match="this device"):
        lock_bench(second)
    of_file = BenchLock(second.lock_path)  # as after a reload that names another device
    kind, (error, text) = error_of_control_process(Task(second, None, tmp_path, ()), of_file, monkeypatch)
    assert (kind, error) == ("error", "BusyError")
    assert "this device" in text
    lock.close()
    lock_bench(second).close()


def test_a_second_bench_of_the_same_device_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    first = BenchLock(tmp_path / "a.lock")
    first.cover(device_names(tcp()))
    second = BenchLock(tmp_path / "b.lock")
    with pytest.raises(BusyError, match=f"process {os.getpid()} drives or watches this device") as caught:
        second.cover(device_names(tcp("localhost")))
    assert caught.value.exit_code == 75
    second.cover(device_names(tcp(port=503)))
    first.close()
    second.cover(device_names(tcp("localhost")))
    second.close()
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("which", ["bench", "device"])
def test_a_removed_lock_file_is_made_again(tmp_path, monkeypatch, which):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    lock = BenchLock(tmp_path / "a.lock")
    lock.cover(device_names(tcp()))
    path = list(lock._held)[which == "device"]
    path.unlink()
    assert lock.restore()
    assert path.exists()
    other = BenchLock(tmp_path / "b.lock")
    with pytest.raises(BusyError):
        other.cover(device_names(tcp())) if which == "device" else BenchLock(tmp_path / "a.lock")
    other.close()
    lock.close()


def test_a_lock_that_another_program_took_after_its_removal_is_lost(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    (tmp_path / "x.lock").unlink()
    other = BenchLock(tmp_path / "x.lock")
    assert not lock.restore()
    other.close()
    lock.close()


def test_no_other_user_can_open_a_lock_file(tmp_path, monkeypatch):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    lock = BenchLock(tmp_path / "x.lock")
    lock.cover(device_names(tcp()))
    assert {path.stat().st_mode & 0o777 for path in lock._held} == {0o600}
    (device,) = [path for path in lock._held if path.name != "x.lock"]
    assert device.parent.stat().st_mode & 0o777 == 0o700
    lock.close()


def test_the_lock_file_of_another_user_keeps_out_a_start_and_no_stop(tmp_path, monkeypatch):
    (tmp_path / "x.lock").touch()
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(BusyError, match="belongs to user 0"):
        BenchLock(tmp_path / "x.lock")
    BenchLock(tmp_path / "x.lock", stopping=True).close()
    assert (tmp_path / "x.lock").exists()


def test_a_folder_that_another_user_has_made_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    (tmp_path / f"piezod-{os.geteuid()}").mkdir()
    os.chown(tmp_path / f"piezod-{os.geteuid()}", 12345, -1)
    assert device_lock_paths("x")[0].parent == tmp_path / f"piezod-{os.geteuid()}-1"


def squat(folder, numbers, kind="folder of another user"):
    """Make what another user can make at the names of the folders of this user."""
    for number in numbers:
        path = folder / f"piezod-{os.geteuid()}{f'-{number}' if number else ''}"
        if kind == "link":
            path.symlink_to(folder)
        elif kind == "file":
            path.touch()
        else:
            path.mkdir(0o777 if kind == "open folder" else 0o700)
            path.chmod(0o777 if kind == "open folder" else 0o700)
            os.chown(path, os.geteuid() if kind == "open folder" else 12345, -1)


def bench_in(folder):
    return load_bench(shipped("bench.yaml")).model_copy(
        update={"daemon": DaemonConfig(ring_log=str(folder / "ring")), "link": tcp("127.0.0.1")}
    )


@pytest.mark.parametrize("kind", ["folder of another user", "link", "file", "open folder"])
def test_folders_of_every_name_keep_out_a_start_with_one_line_and_no_stop(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    squat(tmp_path, range(run_time_files.MOST_FOLDERS), kind)
    with pytest.raises(ConfigurationError, match=r"no folder for locks: .*remove those") as caught:
        lock_bench(bench_in(tmp_path))
    assert "\n" not in str(caught.value)
    lock_bench(bench_in(tmp_path), stopping=True).close()


@pytest.mark.parametrize("kind", ["folder", "link", "fifo", "file", "no folder"])
def test_whatever_stands_at_the_lock_of_the_bench_no_stop_is_blocked(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    bench = bench_in(tmp_path / "none" if kind == "no folder" else tmp_path)
    path = bench.lock_path
    {
        "folder": path.mkdir,
        "link": lambda: path.symlink_to("/etc/passwd"),
        "fifo": lambda: os.mkfifo(path),
        "file": lambda: path.write_text("precious"),
        "no folder": lambda: None,
    }[kind]()
    with pytest.raises(ConfigurationError):
        lock_bench(bench)
    lock_bench(bench, stopping=True).close()


def test_the_folder_of_the_service_or_of_the_login_serves_where_others_have_taken_the_shared_ones(
    tmp_path, monkeypatch
):
    for name in ("SERVICE", "LOGIN", "SHARED"):
        (tmp_path / name).mkdir()
        monkeypatch.setattr(f"piezod.config.run_time_files.{name}", tmp_path / name)
    squat(tmp_path / "SHARED", range(run_time_files.MOST_FOLDERS))
    assert run_time_files.own_folders() == [tmp_path / "SERVICE"]
    (tmp_path / "LOGIN" / str(os.geteuid())).mkdir()
    os.chown(tmp_path / "SERVICE", 12345, -1)
    assert run_time_files.own_folders() == [tmp_path / "LOGIN" / str(os.geteuid()) / "piezod"]
    lock_bench(bench_in(tmp_path)).close()


def test_programs_that_see_other_folders_have_one_lock_in_common(tmp_path, monkeypatch):
    monkeypatch.setattr("piezod.config.run_time_files.SHARED", tmp_path)
    squat(tmp_path, [0, 1])
    (tmp_path / "a").mkdir()
    first = lock_bench(bench_in(tmp_path / "a"))
    for number in (0, 1):  # the other user makes room for a lower number
        (tmp_path / f"piezod-{os.geteuid()}{f'-{number}' if number else ''}").rmdir()
    (tmp_path / "service").mkdir()
    monkeypatch.setattr("piezod.config.run_time_files.SERVICE", tmp_path / "service")
    (tmp_path / "b").mkdir()
    with pytest.raises(BusyError, match="drives or watches this device"):
        lock_bench(bench_in(tmp_path / "b"))
    first.close()
    lock_bench(bench_in(tmp_path / "b")).close()


@pytest.mark.parametrize("content", ["", "999999\n"], ids=["emptied", "of another namespace of process numbers"])
def test_a_held_lock_keeps_out_a_stop_whatever_its_file_says(tmp_path, content):
    lock = BenchLock(tmp_path / "x.lock")
    (tmp_path / "x.lock").write_text(content)
    with pytest.raises(BusyError, match="drives or watches this bench"):
        BenchLock(tmp_path / "x.lock", stopping=True)
    lock.close()


def test_a_holder_that_stands_still_keeps_out_a_stop_until_it_is_killed(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    child = context.Process(target=hold, args=(lock, theirs))
    child.start()
    assert ours.recv() == "held"
    (tmp_path / "x.lock").write_text(f"{child.pid}\n")
    os.close(lock._held.pop(tmp_path / "x.lock"))
    os.kill(child.pid, signal.SIGSTOP)
    os.waitpid(child.pid, os.WUNTRACED)
    with pytest.raises(BusyError):
        BenchLock(tmp_path / "x.lock", stopping=True)
    child.kill()
    child.join()
    BenchLock(tmp_path / "x.lock", stopping=True).close()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs the rights of root")
def test_a_stop_of_root_asks_the_kernel_about_the_lock_file_of_another_user(tmp_path):
    lock = BenchLock(tmp_path / "x.lock")
    os.chown(tmp_path / "x.lock", 12345, -1)
    with pytest.raises(BusyError, match="drives or watches"):
        BenchLock(tmp_path / "x.lock", stopping=True)
    lock.close()
