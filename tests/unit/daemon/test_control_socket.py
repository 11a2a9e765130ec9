"""The socket: permissions, answers, and limits for hostile clients."""

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
from piezod.daemon import admission
from piezod.daemon import control_socket as module
from piezod.daemon.control_socket import ControlSocket
from piezod.errors import BusyError, ConfigurationError


def bench(path, **daemon):
    loaded = load_bench(shipped("bench.yaml"))
    return loaded.model_copy(update={"daemon": loaded.daemon.model_copy(update={"socket": str(path)} | daemon)})


async def answer(command, peer):
    return {"ok": True, "message": command, "uid": peer.uid, "pid": peer.pid, "peer": str(peer)}


@contextlib.asynccontextmanager
async def open_server(path, log=None, **daemon):
    server = ControlSocket(bench(path, **daemon), answer, (log if log is not None else []).append)
    await server.open()
    try:
        yield
    finally:
        await server.close()


async def lines_after(path, sent, *, end=True):
    """Send bytes and return the lines of the answer."""
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


def test_each_line_is_answered_and_the_sender_is_identified(tmp_path):
    async def ask():
        async with open_server(tmp_path / "s"):
            return await lines_after(tmp_path / "s", b'{"command": "status"}\n{"command": "arm"}\n')

    first, second = (json.loads(line) for line in asyncio.run(ask()))
    assert (first["message"], second["message"]) == ("status", "arm")
    assert (first["uid"], first["pid"]) == (os.getuid(), os.getpid())
    assert f"uid {os.getuid()}, gid {os.getgid()}, pid {os.getpid()}" in first["peer"]


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
def test_a_line_that_is_not_a_command_is_refused_in_one_line(tmp_path, line):
    async def ask():
        async with open_server(tmp_path / "s"):
            return await lines_after(tmp_path / "s", line + b"\n")

    (reply,) = asyncio.run(ask())
    assert json.loads(reply)["ok"] is False
    assert json.loads(reply)["code"] == 2


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
@given(st.lists(st.binary(max_size=6000), max_size=5))
def test_arbitrary_bytes_do_not_stop_the_server(tmp_path, chunks):
    async def ask():
        async with open_server(tmp_path / "s"):
            await lines_after(tmp_path / "s", b"\n".join(chunks))
            return await lines_after(tmp_path / "s", b'{"command": "status"}\n')

    assert json.loads(asyncio.run(ask())[0])["ok"] is True


def test_a_line_that_is_too_long_ends_the_connection(tmp_path):
    log = []

    async def ask():
        async with open_server(tmp_path / "s", log):
            return await lines_after(tmp_path / "s", b"x" * 100_000, end=False)

    assert asyncio.run(ask()) == []
    assert "longer than 4096 bytes" in log[0]


def test_an_incomplete_line_ends_the_connection_after_its_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LINE_WITHIN_S", 0.2)

    async def ask():
        async with open_server(tmp_path / "s"):
            return await asyncio.wait_for(lines_after(tmp_path / "s", b'{"comm', end=False), 10)

    assert asyncio.run(ask()) == []


def test_idle_clients_keep_out_a_status_but_neither_a_stop_nor_a_disarm(tmp_path, monkeypatch):
    monkeypatch.setattr(admission, "MAX_CLIENTS", 2)
    log = []

    async def ask():
        async with open_server(tmp_path / "s", log):
            idle = [await asyncio.open_unix_connection(tmp_path / "s") for _ in range(200)]
            await asyncio.sleep(0.1)
            refused = await lines_after(tmp_path / "s", b'{"command": "status"}\n')
            stopped = await lines_after(tmp_path / "s", b'{"command": "stop"}\n{"command": "status"}\n')
            disarmed = await lines_after(tmp_path / "s", b'{"command": "disarm"}\n{"command": "arm"}\n')
            for _, writer in idle:
                writer.close()
            await asyncio.sleep(0.1)
            return refused, stopped, disarmed, await lines_after(tmp_path / "s", b'{"command": "status"}\n')

    refused, stopped, disarmed, served = ([json.loads(line) for line in lines] for lines in asyncio.run(ask()))
    assert (refused[0]["ok"], refused[0]["code"]) == (False, 75)
    assert [one.get("message") for one in stopped] == ["stop", "status"]
    assert [one.get("message") for one in disarmed] == ["disarm", None]
    assert served[0]["ok"]
    assert sum("are connected already" in line for line in log) == 1


def test_mode_and_group_are_as_configured_and_close_removes_the_socket(tmp_path):
    path = tmp_path / "s"

    async def stat_socket():
        async with open_server(path, socket_mode="0662", socket_group="root" if os.getuid() == 0 else None):
            return path.stat()

    before = os.umask(0o077)
    try:
        found = asyncio.run(stat_socket())
    finally:
        os.umask(before)
    assert stat.S_IMODE(found.st_mode) == 0o662
    assert found.st_gid == os.getegid()
    assert not path.exists()


def test_a_socket_without_a_listener_is_replaced(tmp_path):
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(tmp_path / "s"))

    async def ask():
        async with open_server(tmp_path / "s"):
            return await lines_after(tmp_path / "s", b'{"command": "status"}\n')

    assert len(asyncio.run(ask())) == 1


def test_a_socket_with_a_listener_and_a_regular_file_are_not_replaced(tmp_path):
    async def open_it():
        async with open_server(tmp_path / "s"):
            pass

    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(tmp_path / "s"))
        other.listen()
        with pytest.raises(BusyError, match="another daemon listens there"):
            asyncio.run(open_it())
    (tmp_path / "s").unlink()
    (tmp_path / "s").write_text("precious")
    with pytest.raises(ConfigurationError, match="is no socket"):
        asyncio.run(open_it())
    assert (tmp_path / "s").read_text() == "precious"


@pytest.mark.parametrize(
    ("changes", "says"),
    [({"socket_group": "no-such-group"}, "which does not exist"), ({"path": "/nowhere/s"}, "cannot be bound")],
)
def test_an_unusable_path_or_group_is_a_configuration_error(tmp_path, changes, says):
    async def open_it():
        changed = dict(changes)
        async with open_server(changed.pop("path", tmp_path / "s"), **changed):
            pass

    with pytest.raises(ConfigurationError, match=says):
        asyncio.run(open_it())


@pytest.mark.parametrize("turns", range(4))
def test_the_end_of_the_server_during_a_connection_reports_nothing(tmp_path, caplog, turns):
    async def end():
        async with open_server(tmp_path / "s"):
            with socket.socket(socket.AF_UNIX) as client:
                client.setblocking(False)
                client.connect(str(tmp_path / "s"))
                for _ in range(turns):
                    await asyncio.sleep(0)

    asyncio.run(end())
    assert [record.getMessage() for record in caplog.records] == []
