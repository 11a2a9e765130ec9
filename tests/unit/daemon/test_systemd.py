"""Notifications to systemd, received from a real socket."""

import contextlib
import socket

import pytest

from piezod.daemon.systemd import Notifier


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A datagram socket, and its name in the form of NOTIFY_SOCKET."""
    name = str(tmp_path / "notify") if request.param == "path" else f"@piezod-test-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + name[1:] if name.startswith("@") else name)
        listener.settimeout(2)
        yield listener, name


def test_each_message_is_one_datagram(manager):
    listener, name = manager
    notifier = Notifier(name)
    notifier.ready()
    notifier.status("RUNNING: first reference\nreached")
    notifier.alive()
    notifier.starting()
    notifier.stopping()
    notifier.close()
    assert [listener.recv(1024) for _ in range(5)] == [
        b"READY=1",
        b"STATUS=RUNNING: first reference reached",
        b"WATCHDOG=1",
        b"WATCHDOG=1\nEXTEND_TIMEOUT_USEC=10000000",
        b"STOPPING=1",
    ]


def test_a_reload_message_contains_its_time(manager):
    listener, name = manager
    with contextlib.closing(Notifier(name)) as notifier:
        notifier.reloading()
    lines = listener.recv(1024).decode().splitlines()
    assert lines[0] == "RELOADING=1"
    assert lines[1].startswith("MONOTONIC_USEC=")


def test_a_status_is_sent_when_it_changes(manager):
    listener, name = manager
    with contextlib.closing(Notifier(name)) as notifier:
        for text in ("a", "a", "b"):
            notifier.status(text)
        notifier.ready()
    assert [listener.recv(1024) for _ in range(3)] == [b"STATUS=a", b"STATUS=b", b"READY=1"]


def test_the_default_address_is_that_of_the_environment(manager, monkeypatch):
    listener, name = manager
    monkeypatch.setenv("NOTIFY_SOCKET", name)
    with contextlib.closing(Notifier()) as notifier:
        notifier.alive()
    assert listener.recv(1024) == b"WATCHDOG=1"


@pytest.mark.parametrize("address", ["", "/nowhere/notify"])
def test_a_missing_listener_causes_no_error(address):
    notifier = Notifier(address)
    notifier.ready()
    notifier.close()
    notifier.alive()
    assert notifier._socket is None
