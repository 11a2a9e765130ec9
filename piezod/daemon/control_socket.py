"""The unix socket that the daemon is spoken to through: one JSON object a line, one line back.

    -> {"command": "arm"}
    <- {"ok": true, "message": "arming"}
    <- {"ok": false, "error": "arm: state is FAULT ...", "code": 1}

Who may connect is decided by the file's owner, group and mode; who did is asked from the kernel and logged. A line is
short and must come soon, connections are few: a client that is broken, slow or hostile costs the loop nothing, which
runs in another process anyway.
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
LINE_WITHIN_S = 10.0
MOST_CLIENTS = 16
_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid


@dataclass(frozen=True)
class Peer:
    """Who is at the other end, as the kernel says."""

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
    """Listens, and passes each command on.

    Parameters
    ----------
    bench
        Its `daemon` section says where, and who may.
    answer
        Called with the command's name and who sent it; never raises.
    log
        Called with one line about what was refused.
    """

    def __init__(self, bench: BenchConfig, answer: Answer, log: Callable[[str], None]) -> None:
        self._path = bench.socket_path
        self._group, self._mode = bench.daemon.socket_group, int(bench.daemon.socket_mode, 8)
        self._answer, self._log = answer, log
        self._clients: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Bind; a path left by a daemon that died is taken over.

        Raises
        ------
        ConfigurationError
            The path cannot be bound, or the group does not exist.
        BusyError
            Another daemon listens there, or another file is in the way.
        """
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            self._make_way()
            before = os.umask(0o777)  # until owner and mode are set nobody may connect
            try:
                listener.bind(str(self._path))
            finally:
                os.umask(before)
            group = None if self._group is None else _gid_of(self._group)
            if group not in (None, self._path.lstat().st_gid):  # inside the sandbox nothing may be given away
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

    def _make_way(self) -> None:
        """Remove a socket that nobody listens at any more, and nothing else."""
        if not os.path.lexists(self._path):
            return
        if not self._path.is_socket():
            raise BusyError(f"daemon.socket: {self._path} is in the way and no socket; remove it")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            with contextlib.suppress(ConnectionRefusedError, FileNotFoundError):
                probe.connect(str(self._path))
                raise BusyError(f"daemon.socket: {self._path}: another daemon listens there; stop it, or name another")
        self._path.unlink(missing_ok=True)

    async def close(self) -> None:
        """Stop listening and hang up."""
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
        if len(self._clients) >= MOST_CLIENTS:
            self._log(f"socket: {peer} turned away: {MOST_CLIENTS} clients are connected")
            writer.close()
            return
        self._clients.add(task)
        try:
            while line := await self._line(reader, peer):
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

    async def _line(self, reader: asyncio.StreamReader, peer: Peer) -> bytes:
        """Return the next whole line; nothing at the end, or when it is too long or too late."""
        try:
            async with asyncio.timeout(LINE_WITHIN_S):
                return await reader.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return b""
        except asyncio.LimitOverrunError:
            self._log(f"socket: {peer} sent a line longer than {LONGEST_LINE} bytes; hung up")
            return b""
        except TimeoutError:
            return b""

    async def _reply(self, line: bytes, peer: Peer) -> dict[str, object]:
        try:
            request: Any = json.loads(line)
        except (ValueError, RecursionError):
            return _refusal('not one JSON object a line, such as {"command": "status"}')
        command = request.get("command") if isinstance(request, dict) else None
        if not isinstance(command, str) or set(request) != {"command"}:
            return _refusal('must be an object with one key, such as {"command": "status"}')
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
            f"daemon.socket_group is '{group}', no such group here; create it or name another"
        ) from None
