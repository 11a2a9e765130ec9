"""Pseudo-terminals that stand where a serial port stands."""

import asyncio
import contextlib
import os
import tty
from collections.abc import Callable
from pathlib import Path

MOST_BYTES = 4096


class PseudoTerminal:
    """A raw pseudo-terminal served by the running event loop.

    Parameters
    ----------
    received
        Called with the bytes that came in; what it returns is sent back.
    link
        A symbolic link to make to it, or None.
    """

    def __init__(self, received: Callable[[bytes], bytes], link: str | None = None) -> None:
        self._received = received
        self._master, self._slave = os.openpty()  # the slave stays open, or the last client's close would end it
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
        """Stop serving."""
        self._loop.remove_reader(self._master)
        os.close(self._master)
        os.close(self._slave)
        if self._link:
            self._link.unlink(missing_ok=True)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            reply = self._received(os.read(self._master, MOST_BYTES))
            if reply:
                os.write(self._master, reply)  # nobody reads: a serial line loses bytes too
