"""Drive a bench in a process of its own, and follow its ring log from here.

Whatever there is to do besides the loop (showing, recording, answering) happens on this side and cannot slow a tick.
"""

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import piezod.errors
from piezod.config import BenchConfig
from piezod.errors import PiezodError
from piezod.session.lock import BenchLock
from piezod.session.task import Outcome, Task, control

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    import numpy as np
    from numpy.typing import NDArray

    from piezod.control import RingReader
    from piezod.model import Model
    from piezod.session.assembly import Work

LOOK_EVERY_S = 0.1
END_WITHIN_S = 30.0  # a ramp down, however slow

__all__ = ["LOOK_EVERY_S", "Outcome", "Session", "deliberate_error"]


class Session:
    """A control process and the view of its ring log.

    Parameters
    ----------
    bench, model, folder
        What `load` read, and the folder that relative paths start from.
    works
        Driven one after the other; none: the bench is only read, until stopped.
    serves
        The bench configuration whose own reference is followed, with its own model, whenever told to, until stopped.
    lock
        Held by the caller; None: taken at the start and let go at the end.
    """

    def __init__(
        self,
        bench: BenchConfig,
        model: "Model | None",
        folder: Path,
        works: "list[Work]",
        *,
        serves: Path | None = None,
        lock: BenchLock | None = None,
    ) -> None:
        self._task = Task(bench, model, folder, tuple(works), serves)
        self._lock, self._owns_lock = lock, lock is None
        self._pipe: Connection | None = None
        self._process: Any = None
        self._reader: RingReader | None = None
        self._commands = 0
        self.outcome = Outcome()

    @property
    def pid(self) -> int | None:
        """Of the control process."""
        return None if self._process is None else self._process.pid

    @property
    def descriptor(self) -> int:
        """Where the messages of the control process can be waited for."""
        assert self._pipe is not None
        return self._pipe.fileno()

    def launch(self) -> None:
        """Start the control process without waiting for it.

        Raises
        ------
        BusyError
            Another program drives this bench.
        """
        if self._lock is None:
            self._lock = BenchLock(self._task.bench.lock_path)
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=control, args=(self._task, theirs, self._lock), daemon=False)
        self._process.start()
        theirs.close()

    def start(self) -> None:
        """Start the control process and wait until it is connected.

        Raises
        ------
        PiezodError
            What the control process found wrong before anything was written.
        """
        self.launch()
        kind, content = self.receive()
        if kind == "error":
            raise deliberate_error(*content)
        self.open_ring()

    def receive(self) -> tuple[str, Any]:
        """Return the next message: ready, answer (number, kind, text), done (outcome) or error (name, text)."""
        assert self._pipe is not None
        try:
            kind, content = self._pipe.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            kind = "error"
            content = ("PiezodError", f"the control process ended with code {self._process.exitcode}")
        if kind == "done":
            self.outcome = content
        if kind in ("done", "error"):
            self._process.join()
        return kind, content

    def open_ring(self) -> None:
        """Follow the ring log from here on; the control process is ready."""
        from piezod.control import RingReader  # noqa: PLC0415  # heavy, and the control process should start first

        self._reader = RingReader(self._task.bench.ring_log_path)

    def read(self) -> "NDArray[np.void]":
        """Rows of the ring log since the last call."""
        assert self._reader is not None
        return self._reader.read()

    @property
    def dropped(self) -> int:
        """Rows that were overwritten before they were read."""
        return 0 if self._reader is None else self._reader.dropped

    def follow(self) -> Iterator["NDArray[np.void]"]:
        """New rows of the ring log, about ten times a second, until the control process ends.

        Raises
        ------
        PiezodError
            What ended the control process before its work was done.
        """
        assert self._pipe is not None
        while not self._pipe.poll(LOOK_EVERY_S):
            yield self.read()
        kind, content = self.receive()
        if kind == "error":
            raise deliberate_error(*content)
        yield self.read()

    def command(self, name: str, argument: object = None) -> int:
        """Send a command to a control process that serves; returns the number that its answer will carry."""
        assert self._pipe is not None
        self._commands += 1
        with contextlib.suppress(BrokenPipeError):
            self._pipe.send((self._commands, time.monotonic_ns(), name, argument))
        self._signal(signal.SIGUSR1)
        return self._commands

    def stop(self) -> None:
        """Ask for a ramp down and the end; a second time: in haste."""
        self._signal(signal.SIGTERM)

    def _signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            if self._process is not None and self._process.is_alive():
                os.kill(self._process.pid, number)

    def close(self) -> None:
        """Ramp down if it still drives, and wait for the end."""
        if self._process is not None:
            self.stop()
            self._process.join(timeout=END_WITHIN_S)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
            self._task.bench.ring_log_path.unlink(missing_ok=True)
        if self._pipe is not None:
            self._pipe.close()
        if self._lock is not None and self._owns_lock:
            self._lock.close()


def deliberate_error(name: str, text: str) -> PiezodError:
    """Rebuild the error that another process raised."""
    error = getattr(piezod.errors, name, PiezodError)(text)
    assert isinstance(error, PiezodError)
    return error
