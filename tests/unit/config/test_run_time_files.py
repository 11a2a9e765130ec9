"""Files and sockets that a bench file names: only what piezod made is replaced, and its access is set explicitly."""

import os
import socket

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.config.run_time_files import UnixSocket, is_own_file
from piezod.errors import BusyError, ConfigurationError

KINDS = (socket.SOCK_STREAM, socket.SOCK_DGRAM)


def bound(kind, path):
    return UnixSocket(kind, path, "reference.listen", "0660", None)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("make", ["file", "link", "folder", "fifo"])
def test_a_socket_replaces_nothing_but_a_socket(tmp_path, kind, make):
    path = tmp_path / "s"
    target = tmp_path / "target"
    target.write_text("precious")
    {
        "file": lambda: path.write_text("precious"),
        "link": lambda: path.symlink_to(target),
        "folder": path.mkdir,
        "fifo": lambda: os.mkfifo(path),
    }[make]()
    before = path.lstat()
    with pytest.raises(ConfigurationError, match="exists and is no socket"):
        bound(kind, path)
    assert path.lstat().st_ino == before.st_ino
    assert target.read_text() == "precious"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("other_kind", KINDS)
def test_a_socket_with_a_listener_of_any_type_is_busy_and_an_abandoned_one_is_replaced(tmp_path, kind, other_kind):
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX, other_kind) as other:
        other.bind(str(path))
        if other_kind == socket.SOCK_STREAM:
            other.listen()
        with pytest.raises(BusyError, match="another daemon listens there"):
            bound(kind, path)
        assert path.is_socket()
    bound(kind, path).close()
    assert not path.exists()


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to give a file to another user")
def test_a_file_or_socket_of_another_user_is_refused(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
        other.bind(str(tmp_path / "s"))
    (tmp_path / "f").write_bytes(b"PIEZRNG1")
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(ConfigurationError, match="belongs to user 0"):
        bound(socket.SOCK_DGRAM, tmp_path / "s")
    with pytest.raises(ConfigurationError, match="belongs to user 0"):
        is_own_file(tmp_path / "f", "daemon.ring_log", b"PIEZRNG")


def test_close_leaves_a_socket_that_another_process_has_put_there(tmp_path):
    path = tmp_path / "s"
    first = bound(socket.SOCK_DGRAM, path)
    path.unlink()
    second = bound(socket.SOCK_DGRAM, path)
    first.close()
    assert path.is_socket()
    second.close()


@pytest.mark.parametrize("umask", [0o000, 0o027, 0o777])
def test_a_socket_has_its_mode_whatever_the_umask_is(tmp_path, umask):
    before = os.umask(umask)
    try:
        made = UnixSocket(socket.SOCK_DGRAM, tmp_path / "s", "reference.listen", "0662", None)
    finally:
        os.umask(before)
    assert (tmp_path / "s").stat().st_mode & 0o777 == 0o662
    made.close()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("socket: null ", "socket: /dev/shm/piezod-{name}.ring ", "daemon.socket is /dev/shm/piezod-emulator.ring"),
        ("\n  file: null ", "\n  file: /dev/shm/piezod-{name}.ring.lock ", "drift.file is .*, the same as its lock"),
    ],
)
def test_two_run_time_files_with_one_path_are_refused(tmp_path, old, new, says):
    text = shipped("bench.yaml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    (tmp_path / "bench.yaml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=says):
        load_bench(tmp_path / "bench.yaml")
