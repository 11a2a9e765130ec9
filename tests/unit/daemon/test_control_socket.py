"""The socket: who may, what is answered, and what a hostile client cannot do."""

import asyncio
import contextlib
import json
import os
import socket
import stat

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.daemon import control_socket as module
from piezod.daemon.control_socket import ControlSocket
from piezod.errors import BusyError, ConfigurationError


def bench(path, **daemon):
    loaded = load_bench(shipped("bench.yaml"))
    return loaded.model_copy(update={"daemon": loaded.daemon.model_copy(update={"socket": str(path)} | daemon)})


async def answer(command, peer):
    return {"ok": True, "message": command, "uid": peer.uid, "pid": peer.pid, "peer": str(peer)}


@contextlib.asynccontextmanager
async def listening(path, log=None, **daemon):
    server = ControlSocket(bench(path, **daemon), answer, (log if log is not None else []).append)
    await server.open()
    try:
        yield
    finally:
        await server.close()


async def lines_after(path, sent, *, end=True):
    """What comes back when these bytes were sent."""
    reader, writer = await asyncio.open_unix_connection(path)
    with contextlib.suppress(ConnectionError):
        writer.write(sent)
        await writer.drain()
        if end:
            writer.write_eof()
    try:
        return (await reader.read()).splitlines()
    except ConnectionError:
        return []
    finally:
        writer.close()


def test_each_line_is_answered_and_the_kernel_says_who_asked(tmp_path):
    async def ask():
        async with listening(tmp_path / "s"):
            return await lines_after(tmp_path / "s", b'{"command": "status"}\n{"command": "arm"}\n')

    first, second = (json.loads(line) for line in asyncio.run(ask()))
    assert (first["message"], second["message"]) == ("status", "arm")
    assert (first["uid"], first["pid"]) == (os.getuid(), os.getpid())
    assert f"uid {os.getuid()} (" in first["peer"]


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"arm",
        b"[1]",
        b"{}",
        b'{"command": 1}',
        b'{"command": "arm", "force": 1}',
        b"\xff\xfe",
        b'{"command": ',
        b"[" * 4000,
    ],
)
def test_what_is_no_command_is_refused_in_one_line(tmp_path, line):
    async def ask():
        async with listening(tmp_path / "s"):
            return await lines_after(tmp_path / "s", line + b"\n")

    (reply,) = asyncio.run(ask())
    assert json.loads(reply)["ok"] is False
    assert json.loads(reply)["code"] == 2


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(st.lists(st.binary(max_size=6000), max_size=5))
def test_no_bytes_stop_it(tmp_path, chunks):
    async def ask():
        async with listening(tmp_path / "s"):
            await lines_after(tmp_path / "s", b"\n".join(chunks))
            return await lines_after(tmp_path / "s", b'{"command": "status"}\n')

    assert json.loads(asyncio.run(ask())[0])["ok"] is True


def test_a_line_too_long_is_hung_up_on(tmp_path):
    log = []

    async def ask():
        async with listening(tmp_path / "s", log):
            return await lines_after(tmp_path / "s", b"x" * 100_000, end=False)

    assert asyncio.run(ask()) == []
    assert "longer than 4096 bytes" in log[0]


def test_a_line_that_does_not_come_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LINE_WITHIN_S", 0.2)

    async def ask():
        async with listening(tmp_path / "s"):
            return await asyncio.wait_for(lines_after(tmp_path / "s", b'{"comm', end=False), 10)

    assert asyncio.run(ask()) == []


def test_only_so_many_are_served_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MOST_CLIENTS", 2)
    log = []

    async def ask():
        async with listening(tmp_path / "s", log):
            idle = [await asyncio.open_unix_connection(tmp_path / "s") for _ in range(2)]
            await asyncio.sleep(0.1)
            turned_away = await lines_after(tmp_path / "s", b'{"command": "status"}\n')
            for _, writer in idle:
                writer.close()
            await asyncio.sleep(0.1)
            return turned_away, await lines_after(tmp_path / "s", b'{"command": "status"}\n')

    turned_away, served = asyncio.run(ask())
    assert turned_away == []
    assert len(served) == 1
    assert "turned away" in log[0]


def test_mode_and_group_are_those_of_the_configuration_and_the_path_goes_with_the_daemon(tmp_path):
    path = tmp_path / "s"

    async def look():
        async with listening(path, socket_mode="0600", socket_group="root" if os.getuid() == 0 else None):
            return path.stat()

    found = asyncio.run(look())
    assert stat.S_IMODE(found.st_mode) == 0o600
    assert not path.exists()


def test_a_socket_left_behind_is_taken_over(tmp_path):
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "s"))

    async def ask():
        async with listening(tmp_path / "s"):
            return await lines_after(tmp_path / "s", b'{"command": "status"}\n')

    assert len(asyncio.run(ask())) == 1


def test_a_living_socket_and_a_file_are_not_taken_over(tmp_path):
    async def open_it():
        async with listening(tmp_path / "s"):
            pass

    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(tmp_path / "s"))
        other.listen()
        with pytest.raises(BusyError, match="another daemon listens there"):
            asyncio.run(open_it())
    (tmp_path / "s").unlink()
    (tmp_path / "s").write_text("precious")
    with pytest.raises(BusyError, match="no socket"):
        asyncio.run(open_it())
    assert (tmp_path / "s").read_text() == "precious"


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"socket_group": "no-such-group"}, "no such group"), ({"path": "/nowhere/s"}, "cannot be bound")],
)
def test_what_cannot_be_is_a_configuration_error(tmp_path, changes, says):
    async def open_it():
        changed = dict(changes)
        async with listening(changed.pop("path", tmp_path / "s"), **changed):
            pass

    with pytest.raises(ConfigurationError, match=says):
        asyncio.run(open_it())
