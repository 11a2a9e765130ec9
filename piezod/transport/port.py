"""A line without numbered replies (serial port or gateway): receive buffer, waits, and the time to settle.

A late reply could be mistaken for the reply to the next request. After a timeout the line is therefore closed and
opened again. Until the settling time ends, received bytes are discarded.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from math import inf
from select import POLLIN, POLLOUT
from typing import TYPE_CHECKING

from piezod.errors import PiezodError
from piezod.runtime import clock, sockets
from piezod.transport.link import ExchangeResult

if TYPE_CHECKING:
    import socket

    from piezod.transport.tls import TlsStream

RECONNECT_S = 0.05  # shortest time between two attempts to open a line or a connection
RECEIVE_BYTES = 1024  # several frames of the maximum length
MOST_STALE_BYTES = 65536  # more unrequested bytes than this: not the configured device

_OK = ExchangeResult.OK
_DISCONNECTED = ExchangeResult.DISCONNECTED


class Port(ABC):
    """A line that is reopened after a loss, and discards the bytes of the settling time.

    A kind of line implements `open`, `receive`, `_connect`, `_write` and `_disconnect`.

    Attributes
    ----------
    generation
        Number of times the line was opened.
    stale_bytes
        Number of discarded bytes.
    """

    __slots__ = (
        "_line",
        "_not_before_s",
        "_settled_at_s",
        "_shall_be_open",
        "_waiter",
        "buffer",
        "generation",
        "stale_bytes",
        "view",
    )

    def __init__(self) -> None:
        self._line: int | socket.socket | None = None
        self._shall_be_open = False
        self._waiter = sockets.poll()
        self._not_before_s = self._settled_at_s = 0.0
        self.buffer = bytearray(RECEIVE_BYTES)
        self.view = memoryview(self.buffer)
        self.generation = self.stale_bytes = 0

    @abstractmethod
    def open(self) -> None:
        """Open the line; raises UnreachableError, BusyError or ConfigurationError."""

    @abstractmethod
    def receive(self, at: int) -> int:
        """Read the available bytes into `buffer`, starting at byte `at`; raises ConnectionError if the line is lost."""

    @abstractmethod
    def _connect(self, deadline_s: float) -> None:
        """Open the line again by `_use`; raises OSError or PiezodError."""

    @abstractmethod
    def _write(self, frame: bytearray | bytes) -> int:
        """Number of bytes that the kernel accepts now; raises OSError."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Close the open line."""

    def close(self) -> None:
        """Close the line until the next `open`."""
        self._release()
        self._shall_be_open = False
        self._not_before_s = self._settled_at_s = 0.0

    def ensure_open(self, deadline_s: float = inf) -> ExchangeResult:
        """Reopen the line if necessary; DISCONNECTED while it is missing or a late reply is possible."""
        now_s = clock.monotonic()
        if self._line is None:
            if not self._shall_be_open or now_s < self._not_before_s:
                return _DISCONNECTED
            self._not_before_s = now_s + RECONNECT_S
            try:
                self._connect(deadline_s)
            except (OSError, PiezodError):
                return _DISCONNECTED
        if now_s >= self._settled_at_s:
            return _OK
        try:
            self.drain()
        except OSError:
            self._release()
        return _DISCONNECTED

    def close_and_settle(self, settle_s: float) -> None:
        """Close the line; after it is reopened, discard all bytes until `settle_s` from now [s]."""
        self._release()
        self._not_before_s = 0.0
        self._settled_at_s = clock.monotonic() + settle_s

    def close_lost(self) -> None:
        """Close a line that broke; the next attempt to open it follows after `RECONNECT_S`."""
        self._release()
        self._not_before_s = clock.monotonic() + RECONNECT_S

    def wait(self, deadline_s: float) -> bool:
        """Wait for input until `deadline_s` on the monotonic clock; False: none."""
        return bool(self._waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))))

    def drain(self) -> None:
        """Discard unrequested bytes; raises OSError if the line broke or receives without end."""
        poll = self._waiter.poll
        if not poll(0):
            return
        most = self.stale_bytes + MOST_STALE_BYTES
        while poll(0):
            self.stale_bytes += self.receive(0)
            if self.stale_bytes > most:
                raise ConnectionError

    def send(self, frame: bytearray | bytes, deadline_s: float) -> None:
        """Send a complete frame; raises OSError if the line broke, or the deadline passes before the end."""
        if self._line is None:
            raise ConnectionError
        send_frame(self._write, self._line, frame, deadline_s)

    def _use(self, line: "int | socket.socket") -> None:
        """Wait for input on an open descriptor or socket from now on."""
        self._line = line
        self._waiter.register(line, POLLIN)
        self.generation += 1

    def _release(self) -> None:
        if self._line is not None:
            self._waiter.unregister(self._line)
            self._disconnect()
            self._line = None


def send_frame(
    write: Callable[[bytearray | bytes], int],
    line: "int | socket.socket | TlsStream",
    frame: bytearray | bytes,
    deadline_s: float,
) -> None:
    """Send a complete frame until the deadline on the monotonic clock.

    Parameters
    ----------
    write
        Returns the number of bytes that the kernel accepts now.
    line
        Descriptor or socket to which `write` sends.

    Raises
    ------
    OSError
        The line broke, or the deadline passed. After a suspension of the process, a late frame is not sent.
    """
    if clock.monotonic() >= deadline_s:
        raise TimeoutError
    try:
        sent = write(frame)
    except BlockingIOError:
        sent = 0
    if sent == len(frame):
        return
    waiter = sockets.poll()
    waiter.register(line, POLLOUT)
    while sent < len(frame):
        if not waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
            raise TimeoutError
        try:
            sent += write(frame[sent:])
        except BlockingIOError:
            continue
