"""The way to a stop that waits for nothing: a socket and a thread of its own, and a signal to the control process.

    -> {"command": "stop"}
    <- {"ok": true, "message": "stop: passed to the control process"}

Neither the event loop nor the log, a file, a lock or a name service takes part. The thread executes `stop` and `disarm`
only; the kernel checks access by the mode of the socket file. `piezod stop` and `piezod disarm` use it first.
"""

import contextlib
import json
import os
import selectors
import socket
import struct
import sys
from collections.abc import Callable
from pathlib import Path

from piezod.config import BenchConfig
from piezod.config.run_time_files import UnixSocket
from piezod.errors import TemporaryError
from piezod.runtime import clock, descriptors, sockets, threads

COMMANDS = ("stop", "disarm")
LONGEST_LINE = 256  # longest line of a client [byte]
LINE_WITHIN_S = 1.0  # longest time until a client has sent its line [s]
MOST_CLIENTS = 64  # clients at the same time; the one that has waited longest leaves for another
BACKLOG = 64
RETRY_S = 0.05  # pause after a connection that cannot be accepted while no client can leave for it [s]
SWITCH_INTERVAL_S = 5e-4  # longest time that another thread keeps the interpreter [s]; by default ten times as long
Urge = Callable[[str], str]


class StopPath:
    """Server of the stop socket, in a thread.

    Parameters
    ----------
    bench
        Bench configuration; access is that of the control socket.
    urge
        Called in the thread with `stop` or `disarm`; returns the text of the answer. It must not wait.
    """

    def __init__(self, bench: BenchConfig, urge: Urge) -> None:
        self._bench, self._urge = bench, urge
        self._listener: UnixSocket | None = None
        self._thread: threads.Thread | None = None
        self._end_reader = self._end_writer = self._reserve = -1
        self._clients: dict[socket.socket, tuple[float, bytes]] = {}  # when accepted [s], and the line that it began

    def open(self) -> None:
        """Listen, and start the thread.

        Raises
        ------
        ConfigurationError
            The path cannot be bound, or is another kind of file.
        BusyError
            Another daemon listens there.
        """
        sys.setswitchinterval(SWITCH_INTERVAL_S)
        path, daemon = self._bench.stop_socket_path, self._bench.daemon
        self._listener = UnixSocket(socket.SOCK_STREAM, path, "daemon.socket", daemon.socket_mode, daemon.socket_group)
        self._listener.socket.listen(BACKLOG)
        self._end_reader, self._end_writer = descriptors.pipe()
        self._take_reserve()
        self._thread = threads.Thread(target=self._serve, name="stop", daemon=True)
        self._thread.start()

    @property
    def is_present(self) -> bool:
        """Whether a client finds the socket at its path."""
        return self._listener is not None and self._listener.is_present

    def restore(self) -> bool:
        """Listen again if somebody has removed the socket; whether that was so.

        Raises
        ------
        ConfigurationError, BusyError
            As for `open`.
        """
        if self._listener is None or self._listener.is_present:
            return False
        self.close()
        self.open()
        return True

    def close(self) -> None:
        """End the thread and remove the socket."""
        if self._thread is None or self._listener is None:
            return
        descriptors.close(self._end_writer)
        self._thread.join()
        self._thread = None
        self._listener.close()
        descriptors.close(self._end_reader)
        if self._reserve >= 0:
            descriptors.close(self._reserve)
            self._reserve = -1

    def _serve(self) -> None:
        assert self._listener is not None
        listener = self._listener.socket
        with sockets.DefaultSelector() as selector:
            selector.register(listener, selectors.EVENT_READ)
            selector.register(self._end_reader, selectors.EVENT_READ)
            while True:
                for key, _ in selector.select(LINE_WITHIN_S):
                    if key.fd == self._end_reader:
                        self._drop(selector, list(self._clients))
                        return
                    if key.fileobj is listener:
                        self._accept(selector, listener)
                    elif isinstance(key.fileobj, socket.socket) and not self._answer(key.fileobj):
                        self._drop(selector, [key.fileobj])
                expired_s = clock.monotonic() - LINE_WITHIN_S
                self._drop(selector, [client for client, (since_s, _) in self._clients.items() if since_s < expired_s])

    def _accept(self, selector: selectors.BaseSelector, listener: socket.socket) -> None:
        try:
            client, _ = listener.accept()
        except OSError:  # the client has gone, or no descriptor is free: one is freed, and the next turn tries again
            if self._clients:
                self._drop(selector, list(self._clients)[:1])
            elif self._reserve >= 0:
                descriptors.close(self._reserve)
                self._reserve = -1
            else:
                clock.sleep(RETRY_S)  # the listener stays readable, and the loop would spin
            return
        client.setblocking(False)
        if len(self._clients) >= MOST_CLIENTS:
            self._drop(selector, list(self._clients)[:1])
        self._clients[client] = clock.monotonic(), b""
        selector.register(client, selectors.EVENT_READ)

    def _answer(self, client: socket.socket) -> bool:
        """Execute every line that is complete, in whatever pieces it came; whether the client may send more.

        The last line needs no line end: a command ends with its brace.
        """
        since_s, begun = self._clients.get(client, (0.0, b""))  # a client that was just dropped gives an error
        try:
            piece = client.recv(LONGEST_LINE)
            *lines, rest = (begun + piece).split(b"\n")
            if rest.rstrip().endswith(b"}") or not piece or len(rest) > LONGEST_LINE:
                lines.append(rest)
                rest = b""
            self._clients[client] = since_s, rest
            for line in filter(bytes.strip, lines):
                client.send(json.dumps(self._reply(line)).encode() + b"\n")
        except BlockingIOError:
            return True
        except OSError:
            return False
        return bool(piece)

    def _reply(self, line: bytes) -> dict[str, object]:
        try:
            request = json.loads(line)
            command = request["command"]
        except (ValueError, TypeError, KeyError, RecursionError):
            command = None
        if command not in COMMANDS:
            return {"ok": False, "error": 'line must be {"command": "stop"} or {"command": "disarm"}', "code": 2}
        return {"ok": True, "message": f"{command}: {self._urge(command)}"}

    def _drop(self, selector: selectors.BaseSelector, clients: list[socket.socket]) -> None:
        for client in clients:
            if self._clients.pop(client, None) is not None:
                selector.unregister(client)
                client.close()
                if self._reserve < 0:
                    self._take_reserve()

    def _take_reserve(self) -> None:
        """Keep a descriptor for the client that comes when no other one is free."""
        with contextlib.suppress(OSError):
            self._reserve = descriptors.open_file(os.devnull, os.O_RDONLY | os.O_CLOEXEC)


def urge(path: Path, command: str, within_s: float) -> str:
    """Send `stop` or `disarm` to the stop socket and return the text of the answer.

    Parameters
    ----------
    path
        Stop socket of the daemon.
    command
        `stop` or `disarm`.
    within_s
        Longest time to wait [s].

    Raises
    ------
    TemporaryError
        Nobody listens there, or the answer does not come in time.
    """
    try:
        with sockets.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC) as connection:
            # the kernel queues a connection that waits for a full backlog, but refuses one with Python's timeout
            limit = struct.pack("@ll", int(within_s), round(1e6 * (within_s % 1.0)))
            for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):
                connection.setsockopt(socket.SOL_SOCKET, option, limit)
            connection.connect(str(path))
            connection.sendall(json.dumps({"command": command}).encode() + b"\n")
            answer = json.loads(connection.makefile("rb").readline())
    except (OSError, ValueError) as error:
        raise TemporaryError(f"{path}: {command} was not executed: {error}") from error
    return str(answer.get("message") or answer.get("error"))
