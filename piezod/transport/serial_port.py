"""A locked serial port, read and written by its file descriptor."""

import contextlib
import os
import termios
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from piezod.config.link import ModbusRtuLink, SerialLineLink
from piezod.errors import BusyError, PiezodError, UnreachableError
from piezod.runtime import descriptors, processes, serial_ports
from piezod.transport.port import Port
from piezod.transport.port_names import missing_port_remedy

if TYPE_CHECKING:
    import serial


class SerialPort(Port):
    """One serial port with an exclusive lock (flock).

    Parameters
    ----------
    config
        Port, baudrate and character format.
    """

    __slots__ = ("_config", "_descriptor", "_serial", "_whole")

    def __init__(self, config: ModbusRtuLink | SerialLineLink) -> None:
        super().__init__()
        self._config = config
        self._serial: serial.Serial | None = None
        self._descriptor = -1
        self._whole = (self.view,)

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
        self._connect(inf)
        self._shall_be_open = True

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

    def _connect(self, deadline_s: float) -> None:  # noqa: ARG002 - a port opens at once
        config = self._config
        try:
            port = serial_ports.open_port(
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
        self._use(self._descriptor)

    def _write(self, frame: bytearray | bytes) -> int:
        return descriptors.write(self._descriptor, frame)

    def _disconnect(self) -> None:
        if self._serial is not None:
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
