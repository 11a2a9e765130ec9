"""The stop socket: it obeys stop and disarm, whatever other clients and the event loop do."""

import socket
import subprocess
import sys
import threading
import time

import pytest

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.daemon.stop_path import MOST_CLIENTS, StopPath, urge
from piezod.errors import TemporaryError


@pytest.fixture
def bench(tmp_path):
    loaded = load_bench(shipped("bench.yaml"))
    return loaded.model_copy(update={"daemon": loaded.daemon.model_copy(update={"socket": f"{tmp_path}/s.sock"})})


@pytest.fixture
def urged(bench):
    names = []

    def note(name):
        names.append(name)
        return "done"

    server = StopPath(bench, note)
    server.open()
    yield names
    server.close()
    assert not bench.stop_socket_path.exists()


@pytest.mark.parametrize("command", ["stop", "disarm"])
def test_stop_and_disarm_are_obeyed(bench, urged, command):
    assert urge(bench.stop_socket_path, command, 5.0) == f"{command}: done"
    assert urged == [command]


@pytest.mark.parametrize(
    "line",
    [b'{"command": "arm"}\n', b"stop\n", b"[1]\n", b"3\n", b"\xff\n", b"[" * 200 + b"\n", b'{"command": ["stop"]}\n'],
)
def test_the_stop_socket_refuses_anything_but_stop_and_disarm(bench, urged, line):
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(str(bench.stop_socket_path))
        client.sendall(line)
        assert b'"ok": false' in client.makefile("rb").readline()
    assert urged == []


def test_clients_that_only_connect_do_not_keep_out_a_stop(bench, urged):
    idle = [socket.socket(socket.AF_UNIX) for _ in range(2 * MOST_CLIENTS)]
    for client in idle:
        client.connect(str(bench.stop_socket_path))
    assert urge(bench.stop_socket_path, "stop", 5.0) == "stop: done"
    for client in idle:
        client.close()


def test_clients_that_connect_and_close_without_pause_do_not_keep_out_a_stop(bench, urged):
    ends = threading.Event()

    def storm():
        while not ends.is_set():
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(bench.stop_socket_path))

    threads = [threading.Thread(target=storm) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(5):
            assert urge(bench.stop_socket_path, "stop", 5.0) == "stop: done"
    finally:
        ends.set()
        for thread in threads:
            thread.join()


def test_a_main_thread_that_computes_without_pause_does_not_delay_a_stop(bench, urged):
    answered_s = []

    def ask():
        begun_s = time.monotonic()
        urge(bench.stop_socket_path, "stop", 5.0)
        answered_s.append(time.monotonic() - begun_s)

    thread = threading.Thread(target=ask)
    thread.start()
    while thread.is_alive():
        sum(range(10_000))
    thread.join()
    assert urged == ["stop"]


WITHOUT_DESCRIPTORS = """
import contextlib, os, resource, socket, sys, time
from pathlib import Path
from types import SimpleNamespace
from piezod.daemon.stop_path import StopPath

path = Path(sys.argv[1])
daemon = SimpleNamespace(socket_group=None, socket_mode="0660")
server = StopPath(SimpleNamespace(daemon=daemon, stop_socket_path=path), lambda name: "done")
server.open()
time.sleep(0.5)  # the thread has its selector
client, second = socket.socket(socket.AF_UNIX), socket.socket(socket.AF_UNIX)
resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))
taken = []
with contextlib.suppress(OSError):
    while True:
        taken.append(os.open(os.devnull, os.O_RDONLY))
client.settimeout(5.0)
client.connect(str(path))
client.sendall(b'{"command": "stop"}\\n')
answer = client.recv(100)
held = sys.argv[2] == "held"
if held:  # another thread takes the descriptor that was kept
    client.close()
    time.sleep(0.2)
    os.close(server._reserve)
    server._reserve = -1
    taken.append(os.open(os.devnull, os.O_RDONLY))
    second.connect(str(path))
    begun = time.process_time()
    time.sleep(1.0)
    print(time.process_time() - begun)
else:
    print(answer.decode())
"""


@pytest.mark.parametrize("what", ["free", "held"])
def test_without_a_free_descriptor_a_stop_is_obeyed_and_nothing_spins(tmp_path, what):
    command = [sys.executable, "-c", WITHOUT_DESCRIPTORS, str(tmp_path / "s.sock"), what]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    if what == "free":
        assert "stop: done" in done.stdout
    else:
        assert float(done.stdout) < 0.3  # of a second in which a client waits


def test_without_a_daemon_a_stop_is_reported_as_failed(tmp_path):
    with pytest.raises(TemporaryError, match="was not executed"):
        urge(tmp_path / "nobody.sock.stop", "stop", 1.0)


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        ([b'{"comm', b'and": "stop"}\n'], ["stop"]),
        ([b'{"command": "stop"}\n{"command": "disarm"}\n'], ["stop", "disarm"]),
        ([b'{"command": "stop"}'], ["stop"]),
        ([*(bytes([one]) for one in b'{"command": "stop"}\n')], ["stop"]),
        ([b"junk\n", b'{"command": "stop"}\n'], ["stop"]),
        ([b'junk\n{"command": "sto', b'p"}\n{"command": "disarm"}'], ["stop", "disarm"]),
    ],
)
def test_every_line_is_obeyed_in_whatever_pieces_it_comes(bench, urged, pieces, expected):
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(str(bench.stop_socket_path))
        for piece in pieces:
            client.sendall(piece)
            time.sleep(0.02)
        client.shutdown(socket.SHUT_WR)
        answers = client.makefile("rb").readlines()
    assert urged == expected
    assert sum(b'"ok": true' in one for one in answers) == len(expected)


def test_a_line_without_end_is_refused(bench, urged):
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(str(bench.stop_socket_path))
        client.sendall(b"x" * 300)
        assert b'"ok": false' in client.makefile("rb").readline()
    assert urged == []
