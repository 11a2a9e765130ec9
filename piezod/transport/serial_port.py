"""A serial port held by one process, read and written by its descriptor, and distrusted after a late reply.

A serial line carries no number by which a late reply could be told from the next one. After a timeout the port is
therefore closed, opened again, and whatever arrives is thrown away until the worst reply would have come.
"""

import contextlib
import os
import select
import termios
from pathlib import Path
from time import monotonic

import serial

from piezod.config.link import ModbusRtuLink, SerialLineLink
from piezod.errors import BusyError, PiezodError, UnreachableError
from piezod.transport.link import ExchangeResult

REOPEN_S = 0.05  # between two attempts to open a port that is gone
RECEIVE_BYTES = 1024  # several of the longest frames
MOST_STALE_BYTES = 65536  # a line that never falls silent is not this device's

_OK = ExchangeResult.OK
_DISCONNECTED = ExchangeResult.DISCONNECTED


class SerialPort:
    """One port, held with an exclusive lock (flock).

    Parameters
    ----------
    config
        Port, baudrate and character format.

    Attributes
    ----------
    buffer, view
        Where everything is received; the same memory.
    generation
        How often the port was opened.
    stale_bytes
        Bytes discarded.
    """

    __slots__ = (
        "_config",
        "_descriptor",
        "_not_before_s",
        "_poll",
        "_serial",
        "_settled_s",
        "_wanted",
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
        self._poll = select.poll()
        self._wanted = False
        self._not_before_s = self._settled_s = 0.0
        self.buffer = bytearray(RECEIVE_BYTES)
        self.view = memoryview(self.buffer)
        self._whole = (self.view,)
        self.generation = self.stale_bytes = 0

    def open(self) -> None:
        """Open and lock the port.

        Raises
        ------
        UnreachableError
            There is no such port, or no right to open it.
        BusyError
            Another process holds it.
        """
        self.close()
        self._open()
        self._wanted = True

    def close(self) -> None:
        """Let go of the port, until the next `open`."""
        self._let_go()
        self._wanted = False
        self._not_before_s = self._settled_s = 0.0

    def ready(self) -> ExchangeResult:
        """Open the port again if it must be; DISCONNECTED while it is gone, or a late reply may still come."""
        now_s = monotonic()
        if self._serial is None:
            if not self._wanted or now_s < self._not_before_s:
                return _DISCONNECTED
            self._not_before_s = now_s + REOPEN_S
            try:
                self._open()
            except PiezodError:
                return _DISCONNECTED
        if now_s >= self._settled_s:
            return _OK
        try:
            self.drain()
        except OSError:
            self._let_go()
        return _DISCONNECTED

    def distrust(self, settle_s: float) -> None:
        """Close the port; when it is open again, believe nothing that comes within `settle_s` from now."""
        self._let_go()
        self._not_before_s = 0.0
        self._settled_s = monotonic() + settle_s

    def vanished(self) -> None:
        """Close a port that is gone; it is looked for again after a while."""
        self._let_go()
        self._not_before_s = monotonic() + REOPEN_S

    def wait(self, deadline_s: float) -> bool:
        """Wait for input until `deadline_s` on the monotonic clock."""
        return bool(self._poll.poll(max(0.0, 1e3 * (deadline_s - monotonic()))))

    def receive(self, at: int) -> int:
        """Read what is there into `buffer` from byte `at` on.

        Raises
        ------
        ConnectionError
            The port is gone: it stays readable and gives nothing.
        """
        count = os.readv(self._descriptor, (self.view[at:],) if at else self._whole)
        if count == 0:
            raise ConnectionError
        return count

    def drain(self) -> None:
        """Discard what came unasked; raises OSError when the port is gone or does not fall silent."""
        poll = self._poll
        if not poll.poll(0):
            return
        most = self.stale_bytes + MOST_STALE_BYTES
        while poll.poll(0):
            self.stale_bytes += self.receive(0)
            if self.stale_bytes > most:
                raise ConnectionError

    def send(self, frame: bytearray | bytes, deadline_s: float) -> None:
        """Write a whole frame; raises OSError when the port is gone, takes nothing in time, or `deadline_s` is past."""
        if monotonic() >= deadline_s:
            raise TimeoutError
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = os.write(self._descriptor, frame)
        if sent == len(frame):
            return
        waiter = select.poll()
        waiter.register(self._descriptor, select.POLLOUT)
        while sent < len(frame):
            if not waiter.poll(max(0.0, 1e3 * (deadline_s - monotonic()))):
                raise TimeoutError
            with contextlib.suppress(BlockingIOError):
                sent += os.write(self._descriptor, frame[sent:])

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
            port.set_low_latency_mode(True)  # 1 ms instead of 16 ms in FTDI's driver; others have no such switch
        self._serial, self._descriptor = port, port.fileno()
        self._poll.register(self._descriptor, select.POLLIN)
        self.generation += 1

    def _let_go(self) -> None:
        if self._serial is None:
            return
        self._poll.unregister(self._descriptor)
        with contextlib.suppress(OSError, termios.error):
            self._serial.close()
        self._serial, self._descriptor = None, -1


def _explain(port: str, error: BaseException) -> PiezodError:
    """Turn what pyserial raised into an error for people."""
    number = getattr(error, "errno", None)
    if "exclusively lock" in str(error) or number in (11, 16):
        holder = _holder(port)
        return BusyError(f"link: {port} is held by {holder}: stop it first" if holder else f"link: {port} is in use")
    if number == 2 or not Path(port).exists():
        return UnreachableError(f"link: {port} does not exist: is the adapter plugged in? ls /dev/serial/by-id")
    if number == 13:
        return UnreachableError(f"link: {port}: permission denied: add this user to the port's group, often dialout")
    return UnreachableError(f"link: {port} cannot be opened: {error}")


def _holder(port: str) -> str:
    """Name the process that has `port` open, as far as /proc shows it; empty if it does not."""
    target = os.path.realpath(port)
    own = os.getpid()
    for folder in Path("/proc").glob("[0-9]*/fd"):
        with contextlib.suppress(OSError):
            if any(str(entry.readlink()) == target for entry in folder.iterdir()):
                pid = int(folder.parent.name)
                name = (folder.parent / "comm").read_text(encoding="utf-8", errors="replace").strip()
                return f"process {pid} ({name}{', this one' if pid == own else ''})"
    return ""
