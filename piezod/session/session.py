"""A control process as its parent sees it: start, messages, commands, ring log, end.

Everything besides the loop (display, recording, answers to clients) happens in the parent and cannot delay a tick.
"""

import contextlib
import signal
from typing import TYPE_CHECKING, Any

import piezod.errors
from piezod.errors import PiezodError
from piezod.runtime import clock, descriptors, processes
from piezod.session.lock import BenchLock
from piezod.session.task import URGENT, Outcome, SharedMemory, Task

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    import numpy as np
    from numpy.typing import NDArray

    from piezod.control import RingReader

PHASE_CELLS = 24_577
"""Number of int64 values of `piezod.control.phase_times`, which a test compares; its import is slow."""
BAD_EXCHANGE_BYTES = 648  # `piezod.transport.bad_exchange.SIZE`, which a test compares; its import is slow
END_WITHIN_S = 30.0  # longest time of a ramp down and the end of the control process [s]


class Session:
    """A control process, the connection to it, and a reader of its ring log.

    Parameters
    ----------
    task
        Input of the control process.
    lock
        Lock of the bench, which the caller holds until the end.
    correction_size
        Number of float64 values of a learned correction (`RepeatCorrection`); 0: no learned correction.

    Attributes
    ----------
    shared
        Memory that the control process shares with this one.
    outcome
        Outcome of the session, after its end.
    """

    def __init__(self, task: Task, lock: BenchLock, *, correction_size: int = 0) -> None:
        self._task, self._lock = task, lock
        self._pipe: Connection | None = None
        self._process: Any = None
        self._pid_descriptor = -1
        self._reader: RingReader | None = None
        context = processes.spawn_context()
        correction = context.RawArray("d", correction_size) if correction_size else None
        self.shared = SharedMemory(
            context.RawArray("q", PHASE_CELLS), correction, context.RawArray("B", BAD_EXCHANGE_BYTES)
        )
        self._commands = 0
        self._stop_requested = False
        self.outcome = Outcome()

    @property
    def descriptor(self) -> int:
        """File descriptor that becomes readable when the control process sends a message."""
        assert self._pipe is not None
        return self._pipe.fileno()

    def launch(self) -> None:
        """Start the control process without waiting for its connection to the bench."""
        context = processes.spawn_context()
        self._pipe, child_pipe = context.Pipe()
        arguments = (self._task, child_pipe, self._lock, self.shared)
        self._process = context.Process(target=_enter_control_process, args=arguments, daemon=False)
        self._process.start()
        self._pid_descriptor = processes.pid_descriptor(self._process.pid)
        child_pipe.close()

    def receive(self) -> tuple[str, Any]:
        """Wait for the next message of the control process.

        Returns
        -------
        tuple
            `("ready", Ready)`, `("answer", (number, kind, text))`, `("done", outcome)` or
            `("error", (name, text))`.
        """
        assert self._pipe is not None
        try:
            kind, content = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join()
            kind = "error"
            content = ("PiezodError", f"the control process ended with code {self._process.exitcode}")
        if kind == "done":
            self.outcome = content
        if kind in ("done", "error"):
            self._process.join()
        return kind, content

    def open_ring_log(self) -> None:
        """Open the ring log; call it after the message `ready`."""
        from piezod.control import RingReader  # noqa: PLC0415  # slow import; the control process starts before it

        self._reader = RingReader(self._task.bench.ring_log_path)

    @property
    def ring_log_is_broken(self) -> bool:
        """Whether somebody has removed or truncated the file of the ring log."""
        return self._reader is not None and self._reader.is_broken

    def read(self) -> "NDArray[np.void]":
        """Rows of the ring log since the last call, shape (N,)."""
        assert self._reader is not None
        return self._reader.read()

    @property
    def dropped(self) -> int:
        """Number of rows that were overwritten before they were read."""
        return 0 if self._reader is None else self._reader.dropped

    def command(self, name: str, argument: object = None, requested_ns: int | None = None) -> int:
        """Send a command to a control process that serves.

        Parameters
        ----------
        name, argument
            Command (`session/command_queue.py`).
        requested_ns
            Monotonic time of the request, from which the command expires [ns]; None: now.

        Returns
        -------
        int
            Number that the answer will carry.
        """
        assert self._pipe is not None
        self._commands += 1
        with contextlib.suppress(OSError):
            self._pipe.send((self._commands, requested_ns or clock.monotonic_ns(), name, argument))
        self._signal(signal.SIGUSR1)
        return self._commands

    def urge(self, name: str) -> bool:
        """Command `stop` or `disarm` by a signal, without waiting; safe in every thread and in a signal handler.

        Parameters
        ----------
        name
            `stop` or `disarm`.

        Returns
        -------
        bool
            Whether a control process received it. It must have sent `ready`.
        """
        return self._signal(URGENT[name])

    def stop(self) -> None:
        """Request a ramp down and the end; the second call ramps down at the slew limit."""
        self._signal(signal.SIGUSR2 if self._stop_requested else signal.SIGTERM)
        self._stop_requested = True

    def _signal(self, number: int) -> bool:
        """Send a signal by the descriptor of the process, which never means another one; False if it has ended."""
        try:
            processes.send_signal(self._pid_descriptor, number)
        except OSError:
            return False
        return True

    @property
    def counters(self) -> tuple[int, ...]:
        """Counters of the control process in the ring log; empty before it is opened."""
        return () if self._reader is None else self._reader.counters

    def close(self) -> None:
        """Ramp down if the bench is still driven, wait for the end, and remove the ring log."""
        if self._process is not None:
            self._signal(signal.SIGTERM)  # never a second call of `stop`: closing is no reason for haste
            self._process.join(timeout=END_WITHIN_S)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
            from piezod.recording.ring_log import remove_ring_log  # noqa: PLC0415  # slow import, needed at the end only

            remove_ring_log(self._task.bench.ring_log_path)
            descriptor, self._pid_descriptor = self._pid_descriptor, -1
            if descriptor >= 0:
                descriptors.close(descriptor)
        if self._pipe is not None:
            self._pipe.close()


def rebuild_error(name: str, text: str) -> PiezodError:
    """Make the error that another process raised.

    Parameters
    ----------
    name
        Class name in `piezod.errors`; another name gives a `PiezodError`.
    """
    error = getattr(piezod.errors, name, PiezodError)(text)
    assert isinstance(error, PiezodError)
    return error


def _enter_control_process(task: Task, pipe: "Connection", lock: BenchLock, shared: SharedMemory) -> None:
    """Run in the new process: import the control process there, and not in its parent."""
    from piezod.session.control_process import run  # noqa: PLC0415  # slow import that the parent does not need

    run(task, pipe, lock, shared)
