"""Fuzzing of the control socket: any bytes of a client that may connect."""

import asyncio
import json
import socket
import weakref
from typing import Any

from piezod.commissioning.shipped_files import shipped
from piezod.config import load_bench
from piezod.daemon.control_socket import ControlSocket, Peer
from tests.fuzz.target import Check, Target

COMMANDS = ("status", "arm", "disarm", "stop", "reset", "reload")


class RecordingWriter:
    """Replacement of the stream writer to the client; `lines` holds the written bytes."""

    def __init__(self, ours: socket.socket) -> None:
        self._socket = ours
        self.lines = b""

    def get_extra_info(self, _name: str) -> socket.socket:
        return self._socket

    def write(self, data: bytes) -> None:
        self.lines += data

    async def drain(self) -> None:
        pass

    def close(self) -> None:
        pass

    async def wait_closed(self) -> None:
        pass


def seeds() -> list[bytes]:
    """Every command, all commands in a row, an escaped command, and a line without JSON."""
    lines = [json.dumps({"command": command}).encode() + b"\n" for command in COMMANDS]
    return [*lines, b"".join(lines), b'{"command": "\\u0061rm", "x": [1, {"y": null}]}\n', b"status\n"]


def check() -> Check:
    """Check that only a whole line with the one key `command` executes a command."""
    ours, theirs = socket.socketpair(socket.AF_UNIX)
    done: list[str] = []

    async def answer(command: str, _peer: Peer) -> dict[str, object]:
        done.append(command)
        return {"ok": command in COMMANDS, "error": f"command is {command!r}"}

    control = ControlSocket(load_bench(shipped("bench.yaml")), answer, lambda _line: None)

    async def serve(data: bytes) -> bytes:
        reader = asyncio.StreamReader(limit=4096)
        reader.feed_data(data)
        reader.feed_eof()
        writer: Any = RecordingWriter(ours)
        await control._serve(reader, writer)
        return writer.lines

    def send(data: bytes) -> None:
        done.clear()
        answers = asyncio.run(serve(data)).split(b"\n")
        if answers.pop() != b"" or not all(isinstance(json.loads(line), dict) for line in answers):
            raise AssertionError("an answer is not a line of JSON")
        if done != _requested(data):
            raise AssertionError(f"executed {done}, requested {_requested(data)}")

    for held in (ours, theirs):
        weakref.finalize(send, held.close)
    return send


def _requested(data: bytes) -> list[str]:
    """The commands of whole lines, up to the first line that is too long."""
    commands = []
    for line in data.split(b"\n")[:-1]:
        if len(line) > 4096:
            break
        try:
            content = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(content, dict) and list(content) == ["command"] and isinstance(content["command"], str):
            commands.append(content["command"])
    return commands


TARGETS = [Target("control_socket", "messages", seeds, check)]
