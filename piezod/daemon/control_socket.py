"""The unix socket of the daemon: each line with a JSON object is answered with one line.

    -> {"command": "arm"}
    <- {"ok": true, "message": "arming"}
    <- {"ok": false, "error": "arm: state is FAULT ...", "code": 1}

Owner, group and mode of the socket file decide who may connect. The kernel reports who has connected, and the daemon
logs it. The length of a line, the time for a line and the number of clients are limited. A faulty, slow or hostile
client therefore cannot block the daemon. The control loop runs in another process.
"""

import asyncio
import contextlib
import grp
import json
import os
import pwd
import socket
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from piezod.config import BenchConfig
from piezod.errors import BusyError, ConfigurationError

LONGEST_LINE = 4096
"""Longest line of a client [byte]."""
LINE_WITHIN_S = 10.0
"""Longest time until a client has sent a line, or has read its answer [s]."""
MAX_CLIENTS = 16
_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid


@dataclass(frozen=True)
class Peer:
    """Process, user and group of a client, as the kernel reports them."""

    pid: int
    uid: int
    gid: int

    def __str__(self) -> str:
        try:
            name = pwd.getpwuid(self.uid).pw_name
        except KeyError:
            name = "unknown"
        return f"uid {self.uid} ({name}), gid {self.gid}, pid {self.pid}"


Answer = Callable[[str, Peer], Awaitable[dict[str, object]]]


class ControlSocket:
    """Server that passes each command to a function and sends its answer.

    Parameters
    ----------
    bench
        Bench configuration; its section `daemon` has path, group and mode of the socket.
    answer
        Called with the name of the command and its sender; must not raise.
    log
        Called with one line about a client that was refused.
    """

    def __init__(self, bench: BenchConfig, answer: Answer, log: Callable[[str], None]) -> None:
        self._path = bench.socket_path
        self._group, self._mode = bench.daemon.socket_group, int(bench.daemon.socket_mode, 8)
        self._answer, self._log = answer, log
        self._clients: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Listen; the socket file of a daemon that died is replaced.

        Raises
        ------
        ConfigurationError
            The path cannot be bound, or the group does not exist.
        BusyError
            Another daemon listens there, or the path is another kind of file.
        """
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._remove_unused_socket()
            before = os.umask(0o777)  # nobody may connect before group and mode are set
            try:
                listener.bind(str(self._path))
            finally:
                os.umask(before)
            group = None if self._group is None else _gid_of(self._group)
            if group not in (None, self._path.lstat().st_gid):  # the sandbox of the service forbids chown
                os.chown(self._path, -1, group)
            self._path.chmod(self._mode)
            listener.setblocking(False)
            self._server = await asyncio.start_unix_server(self._serve, sock=listener, limit=LONGEST_LINE)
        except OSError as error:
            listener.close()
            raise ConfigurationError(
                f"daemon.socket: {self._path} cannot be bound: {error.strerror or error}"
            ) from error
        except BaseException:
            listener.close()
            raise

    def _remove_unused_socket(self) -> None:
        """Remove a socket without a listener; refuse any other file."""
        if not os.path.lexists(self._path):
            return
        if not self._path.is_socket():
            raise BusyError(f"daemon.socket: {self._path} is a file and no socket; remove it")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            with contextlib.suppress(ConnectionRefusedError, FileNotFoundError):
                probe.connect(str(self._path))
                raise BusyError(f"daemon.socket: {self._path}: another daemon listens there; stop it, or name another")
        self._path.unlink(missing_ok=True)

    async def close(self) -> None:
        """Close the server and every connection, and remove the socket."""
        if self._server is None:
            return
        self._server.close()
        for client in list(self._clients):
            client.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)
        self._path.unlink(missing_ok=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        peer = _peer_of(writer)
        if len(self._clients) >= MAX_CLIENTS:
            self._log(f"socket: {peer} refused: {MAX_CLIENTS} clients are connected already")
            writer.close()
            return
        self._clients.add(task)
        try:
            while line := await self._read_line(reader, peer):
                writer.write(json.dumps(await self._reply(line, peer)).encode() + b"\n")
                async with asyncio.timeout(LINE_WITHIN_S):
                    await writer.drain()
        except (OSError, TimeoutError, asyncio.CancelledError):
            pass
        finally:
            self._clients.discard(task)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()

    async def _read_line(self, reader: asyncio.StreamReader, peer: Peer) -> bytes:
        """Return the next line; empty at the end, and for a line that is too long or too late."""
        try:
            async with asyncio.timeout(LINE_WITHIN_S):
                return await reader.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return b""
        except asyncio.LimitOverrunError:
            self._log(f"socket: {peer} sent a line longer than {LONGEST_LINE} bytes; disconnected")
            return b""
        except TimeoutError:
            return b""

    async def _reply(self, line: bytes, peer: Peer) -> dict[str, object]:
        try:
            request: Any = json.loads(line)
        except (ValueError, RecursionError):
            return _refusal('line is not JSON, must be one object such as {"command": "status"}')
        command = request.get("command") if isinstance(request, dict) else None
        if not isinstance(command, str) or set(request) != {"command"}:
            return _refusal('line must be an object with one key, such as {"command": "status"}')
        return await self._answer(command, peer)


def _refusal(text: str) -> dict[str, object]:
    return {"ok": False, "error": text, "code": 2}


def _peer_of(writer: asyncio.StreamWriter) -> Peer:
    raw = writer.get_extra_info("socket").getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Peer(*_CREDENTIALS.unpack(raw))


def _gid_of(group: str) -> int:
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise ConfigurationError(
            f"daemon.socket_group is '{group}', which does not exist; create it or name another"
        ) from None
