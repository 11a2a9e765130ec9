"""Pseudo-terminals in place of serial ports."""

import asyncio
import contextlib
import os
import tty
from collections.abc import Callable
from pathlib import Path

MOST_BYTES = 4096


class PseudoTerminal:
    """A raw pseudo-terminal that the running event loop serves.

    Parameters
    ----------
    received
        Called with the received bytes; returns the bytes to send.
    link
        Path of a symbolic link to it; None: no link.
    """

    def __init__(self, received: Callable[[bytes], bytes], link: str | None = None) -> None:
        self._received = received
        self._master, self._slave = os.openpty()  # open slave: the terminal survives the close of the last client
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._link = Path(link) if link else None
        if self._link:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.path)
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._master, self._readable)

    def close(self) -> None:
        """Stop serving; close the terminal and remove the link."""
        self._loop.remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        if self._link:
            self._link.unlink(missing_ok=True)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            reply = self._received(os.read(self._master, MOST_BYTES))
            if reply:
                os.write(self._master, reply)  # without a reader the bytes are lost, as on a serial line
