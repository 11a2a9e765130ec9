"""The unix socket of the daemon: each line with a JSON object is answered with one line.

    -> {"command": "arm"}
    <- {"ok": true, "message": "arming"}
    <- {"ok": false, "error": "arm: state is FAULT ...", "code": 1}

Owner, group and mode of the socket file decide who may connect. The kernel reports who has connected, and the daemon
logs it. The length of a line, the time for a line and the number of clients are limited. A faulty, slow or hostile
client therefore cannot block the daemon. The control loop runs in another process.

`stop` and `disarm` are obeyed however many clients are connected (`daemon/admission.py`).
"""

import asyncio
import contextlib
import json
import socket
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from piezod.config import BenchConfig
from piezod.config.run_time_files import UnixSocket
from piezod.daemon.admission import MAX_CLIENTS, MAX_PER_USER, Admission, Place
from piezod.daemon.connections import Connections
from piezod.errors import ConfigurationError, TemporaryError

LONGEST_LINE = 4096  # longest line of a client [byte]
LINE_WITHIN_S = 10.0  # longest time until a client has sent a line, or has read its answer [s]
URGENT_WITHIN_S = 2.0  # longest time until a client in the waiting room has sent its line [s]
ACCEPTED_AT_ONCE = 8
"""Connections that are accepted before the lines that have arrived are read; far below the size of the waiting room."""
BACKLOG = 1024  # connections that the kernel holds until they are accepted
_FULL_TEXT = (
    f"{MAX_CLIENTS} clients, or {MAX_PER_USER} of this user, are connected already; only stop and disarm are obeyed now"
)
_CREDENTIALS = struct.Struct("3i")  # struct ucred: pid, uid, gid


@dataclass(frozen=True)
class Peer:
    """Process, user and group of a client, as the kernel reports them."""

    pid: int
    uid: int
    gid: int

    def __str__(self) -> str:
        return f"uid {self.uid}, gid {self.gid}, pid {self.pid}"  # a name would wait for a name service


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
        self._bench, self._answer, self._log = bench, answer, log
        self._clients: Admission[asyncio.Task[None]] = Admission()
        self._connections = Connections(self._serve)
        self._is_full = False
        self._listener: UnixSocket | None = None
        self._server: asyncio.Server | None = None

    async def open(self) -> None:
        """Listen; the socket file of a daemon that died is replaced.

        Raises
        ------
        ConfigurationError
            The path cannot be bound, is another kind of file, or the group does not exist.
        BusyError
            Another daemon listens there.
        """
        path, daemon = self._bench.socket_path, self._bench.daemon
        listener = UnixSocket(socket.SOCK_STREAM, path, "daemon.socket", daemon.socket_mode, daemon.socket_group)
        try:
            self._server = await asyncio.start_unix_server(
                self._connections.accept, sock=listener.socket, limit=LONGEST_LINE, backlog=ACCEPTED_AT_ONCE
            )
            listener.socket.listen(BACKLOG)
        except OSError as error:
            listener.close()
            raise ConfigurationError(f"daemon.socket: {path} cannot be bound: {error.strerror or error}") from error
        self._listener = listener

    @property
    def is_present(self) -> bool:
        """Whether a client finds the socket at its path."""
        return self._listener is not None and self._listener.is_present

    async def restore(self) -> bool:
        """Listen again if somebody has removed the socket; whether that was so. Clients stay connected.

        Raises
        ------
        ConfigurationError, BusyError
            As for `open`.
        """
        if self._listener is None or self._listener.is_present:
            return False
        former = self._server
        await self.open()
        if former is not None:
            former.close()
        return True

    async def close(self) -> None:
        """Close the server and every connection, and remove the socket."""
        if self._server is None or self._listener is None:
            return
        await self._connections.close(self._server)
        self._listener.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        peer = _peer_of(writer)
        place, disconnected = self._clients.admit(task, peer.uid)
        if disconnected is not None:
            disconnected.client.cancel()
        self._log_full(peer, is_full=not place.served)
        try:
            while line := await self._read_line(reader, peer, place):
                writer.write(json.dumps(await self._reply(line, peer, place)).encode() + b"\n")
                async with asyncio.timeout(LINE_WITHIN_S):
                    await writer.drain()
        except (OSError, TimeoutError, asyncio.CancelledError):
            pass
        finally:
            self._clients.leave(place)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()

    def _log_full(self, peer: Peer, *, is_full: bool) -> None:
        """Log once when the places are taken, and not for each client that comes then."""
        if is_full and not self._is_full:
            self._log(f"socket: {peer}: {_FULL_TEXT}")
        self._is_full = is_full

    async def _read_line(self, reader: asyncio.StreamReader, peer: Peer, place: Place[asyncio.Task[None]]) -> bytes:
        """Return the next line; empty at the end, and for a line that is too long or too late."""
        try:
            async with asyncio.timeout(LINE_WITHIN_S if place.served or place.commanded else URGENT_WITHIN_S):
                return await reader.readuntil(b"\n")
        except asyncio.IncompleteReadError:
            return b""
        except asyncio.LimitOverrunError:
            self._log(f"socket: {peer} sent a line longer than {LONGEST_LINE} bytes; disconnected")
            return b""
        except TimeoutError:
            return b""

    async def _reply(self, line: bytes, peer: Peer, place: Place[asyncio.Task[None]]) -> dict[str, object]:
        try:
            request: Any = json.loads(line)
        except (ValueError, RecursionError):
            return _refusal('line is not JSON, must be one object such as {"command": "status"}')
        command = request.get("command") if isinstance(request, dict) else None
        if not isinstance(command, str) or set(request) != {"command"}:
            return _refusal('line must be an object with one key, such as {"command": "status"}')
        if not place.may_send(command):
            return {"ok": False, "error": f"{command}: {_FULL_TEXT}; try again", "code": TemporaryError.exit_code}
        place.commanded = not place.served
        return await self._answer(command, peer)


def _refusal(text: str) -> dict[str, object]:
    return {"ok": False, "error": text, "code": 2}


def _peer_of(writer: asyncio.StreamWriter) -> Peer:
    raw = writer.get_extra_info("socket").getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Peer(*_CREDENTIALS.unpack(raw))
