"""Notifications to systemd (sd_notify): one datagram per message to the socket that `$NOTIFY_SOCKET` names.

Without that variable nothing is sent.
"""

import contextlib
import os
import socket

from piezod.runtime import clock, sockets

EXTEND_S = 10  # time by which `starting` extends the start timeout of systemd [s]


class Notifier:
    """Sends `READY=1`, `STATUS=...`, `WATCHDOG=1` and the other messages.

    Parameters
    ----------
    address
        Path of the socket, or a name in the abstract name space, which begins with "@". Empty: nothing is sent.
        None: the value of `$NOTIFY_SOCKET`.
    """

    def __init__(self, address: str | None = None) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "") if address is None else address
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = sockets.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self._status = ""

    def send(self, *assignments: str) -> None:
        """Send the assignments in one datagram; an error is ignored.

        Parameters
        ----------
        assignments
            Texts of the form `NAME=value`.
        """
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(assignments).encode(), self._address)

    def ready(self) -> None:
        """Report the end of the start or of a reload."""
        self.send("READY=1")

    def reloading(self) -> None:
        """Report that the configuration is being read; `ready` reports the end."""
        self.send("RELOADING=1", f"MONOTONIC_USEC={clock.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report that the daemon ends."""
        self.send("STOPPING=1")

    def starting(self) -> None:
        """Report that a control process starts; extends the start timeout and restarts the watchdog timer."""
        self.send("WATCHDOG=1", f"EXTEND_TIMEOUT_USEC={EXTEND_S * 1_000_000}")

    def alive(self) -> None:
        """Report that the control process ticks; restarts the watchdog timer of systemd."""
        self.send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Set the text of `systemctl status`; sent only if it differs from the last text.

        Parameters
        ----------
        text
            Text; line breaks become spaces.
        """
        text = " ".join(text.split())
        if text != self._status:
            self._status = text
            self.send(f"STATUS={text}")

    def close(self) -> None:
        """Close the socket; later messages are not sent."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
