"""A locked serial port, read and written by its file descriptor, with a settling time after a late reply.

Replies on a serial line have no number. A late reply could be mistaken for the reply to the next request.
After a timeout the port is therefore closed and reopened. Until the settling time ends, received bytes are discarded.
"""

import contextlib
import os
import select
import termios
from math import inf
from pathlib import Path

import serial

from piezod.config.link import ModbusRtuLink, SerialLineLink
from piezod.errors import BusyError, PiezodError, UnreachableError
from piezod.runtime import clock, descriptors, processes, sockets
from piezod.transport.link import ExchangeResult
from piezod.transport.port_names import missing_port_remedy

REOPEN_S = 0.05  # shortest time between two attempts to open a missing port
RECEIVE_BYTES = 1024  # several frames of the maximum length
MOST_STALE_BYTES = 65536  # more unrequested bytes than this: not the configured device

_OK = ExchangeResult.OK
_DISCONNECTED = ExchangeResult.DISCONNECTED


class SerialPort:
    """One serial port with an exclusive lock (flock).

    Parameters
    ----------
    config
        Port, baudrate and character format.

    Attributes
    ----------
    buffer, view
        Receive buffer and a view of the same memory.
    generation
        Number of times the port was opened.
    stale_bytes
        Number of discarded bytes.
    """

    __slots__ = (
        "_config",
        "_descriptor",
        "_not_before_s",
        "_poll",
        "_serial",
        "_settled_at_s",
        "_shall_be_open",
        "_whole",
        "buffer",
        "generation",
        "stale_bytes",
        "view",
    )

    def __init__(self, config: ModbusRtuLink | SerialLineLink) -> None:
        self._config = config
        self._serial: serial.Serial | None = None
        self._descriptor = -1
        self._poll = sockets.poll()
        self._shall_be_open = False
        self._not_before_s = self._settled_at_s = 0.0
        self.buffer = bytearray(RECEIVE_BYTES)
        self.view = memoryview(self.buffer)
        self._whole = (self.view,)
        self.generation = self.stale_bytes = 0

    def open(self) -> None:
        """Open and lock the port.

        Raises
        ------
        UnreachableError
            The port does not exist, or the user has no permission.
        BusyError
            Another process holds the lock.
        """
        self.close()
        self._open()
        self._shall_be_open = True

    def close(self) -> None:
        """Close the port until the next `open`."""
        self._release()
        self._shall_be_open = False
        self._not_before_s = self._settled_at_s = 0.0

    def ensure_open(self, deadline_s: float = inf) -> ExchangeResult:  # noqa: ARG002 - a port opens at once
        """Reopen the port if necessary; DISCONNECTED while it is missing or a late reply is possible."""
        now_s = clock.monotonic()
        if self._serial is None:
            if not self._shall_be_open or now_s < self._not_before_s:
                return _DISCONNECTED
            self._not_before_s = now_s + REOPEN_S
            try:
                self._open()
            except PiezodError:
                return _DISCONNECTED
        if now_s >= self._settled_at_s:
            return _OK
        try:
            self.drain()
        except OSError:
            self._release()
        return _DISCONNECTED

    def close_and_settle(self, settle_s: float) -> None:
        """Close the port; after it is reopened, discard all bytes until `settle_s` from now [s]."""
        self._release()
        self._not_before_s = 0.0
        self._settled_at_s = clock.monotonic() + settle_s

    def close_lost(self) -> None:
        """Close a port that disappeared; the next attempt to open it follows after `REOPEN_S`."""
        self._release()
        self._not_before_s = clock.monotonic() + REOPEN_S

    def wait(self, deadline_s: float) -> bool:
        """Wait for input until `deadline_s` on the monotonic clock; False: none."""
        return bool(self._poll.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))))

    def receive(self, at: int) -> int:
        """Read the available bytes into `buffer`, starting at byte `at`.

        Raises
        ------
        ConnectionError
            The port disappeared: it is readable, but contains no bytes.
        """
        count = descriptors.readv(self._descriptor, (self.view[at:],) if at else self._whole)
        if count == 0:
            raise ConnectionError
        return count

    def drain(self) -> None:
        """Discard unrequested bytes; raises OSError if the port disappeared or receives without end."""
        poll = self._poll
        if not poll.poll(0):
            return
        most = self.stale_bytes + MOST_STALE_BYTES
        while poll.poll(0):
            self.stale_bytes += self.receive(0)
            if self.stale_bytes > most:
                raise ConnectionError

    def send(self, frame: bytearray | bytes, deadline_s: float) -> None:
        """Write a complete frame; raises OSError if the port disappeared, or the deadline passes before the end."""
        if clock.monotonic() >= deadline_s:
            raise TimeoutError
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = descriptors.write(self._descriptor, frame)
        if sent == len(frame):
            return
        waiter = sockets.poll()
        waiter.register(self._descriptor, select.POLLOUT)
        while sent < len(frame):
            if not waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
                raise TimeoutError
            with contextlib.suppress(BlockingIOError):
                sent += descriptors.write(self._descriptor, frame[sent:])

    def _open(self) -> None:
        config = self._config
        try:
            port = serial.Serial(
                config.port,
                config.baudrate,
                bytesize=config.bytesize,
                parity=config.parity,
                stopbits=config.stopbits,
                timeout=0,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            raise _explain(config.port, error) from error
        with contextlib.suppress(OSError, ValueError):
            port.set_low_latency_mode(True)  # 1 ms instead of 16 ms with FTDI's driver; other drivers raise
        self._serial, self._descriptor = port, port.fileno()
        self._poll.register(self._descriptor, select.POLLIN)
        self.generation += 1

    def _release(self) -> None:
        if self._serial is None:
            return
        self._poll.unregister(self._descriptor)
        with contextlib.suppress(OSError, termios.error):
            self._serial.close()
        self._serial, self._descriptor = None, -1


def _explain(port: str, error: BaseException) -> PiezodError:
    """Convert an error of pyserial into an error with cause and remedy."""
    number = getattr(error, "errno", None)
    if "exclusively lock" in str(error) or number in (11, 16):
        holder = _holder(port)
        return BusyError(f"link: {port} is held by {holder}: stop it first" if holder else f"link: {port} is in use")
    if number == 2 or not Path(port).exists():
        return UnreachableError(f"link: {port} does not exist: {missing_port_remedy(port)}")
    if number == 13:
        return UnreachableError(f"link: {port}: permission denied: add this user to the port's group, often dialout")
    return UnreachableError(f"link: {port} cannot be opened: {error}")


def _holder(port: str) -> str:
    """Name of the process that has `port` open, from /proc; empty: not visible."""
    target = os.path.realpath(port)
    own = processes.number()
    for folder in Path("/proc").glob("[0-9]*/fd"):
        with contextlib.suppress(OSError):
            if any(str(entry.readlink()) == target for entry in folder.iterdir()):
                pid = int(folder.parent.name)
                name = (folder.parent / "comm").read_text(encoding="utf-8", errors="replace").strip()
                return f"process {pid} ({name}{', this one' if pid == own else ''})"
    return ""
