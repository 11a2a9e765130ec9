"""What systemd wants to be told: one datagram a message, to the socket that it names; without one nothing happens."""

import contextlib
import os
import socket
import time


class Notifier:
    """Sends `READY=1`, `STATUS=...`, `WATCHDOG=1` and the like.

    Parameters
    ----------
    address
        `$NOTIFY_SOCKET`: a path, or a name that begins with @ (the abstract name space); empty: nobody listens.
    """

    def __init__(self, address: str | None = None) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "") if address is None else address
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self._status = ""

    def send(self, *assignments: str) -> None:
        """Send them in one datagram; a manager that does not listen is no reason to stop."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(assignments).encode(), self._address)

    def ready(self) -> None:
        """The start is over: disarmed and, if the device answers, reading."""
        self.send("READY=1")

    def reloading(self) -> None:
        """A new configuration is being read; `ready` ends it."""
        self.send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """The end has begun."""
        self.send("STOPPING=1")

    def alive(self) -> None:
        """The control process ticks."""
        self.send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line for `systemctl status`, sent when it changes."""
        text = " ".join(text.split())
        if text != self._status:
            self._status = text
            self.send(f"STATUS={text}")

    def close(self) -> None:
        """Say nothing more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
