"""Drive a bench in a process of its own, and follow its ring log from here.

The control process is one thread that reads, plans and writes. Whatever else there is to do (showing, recording,
drawing) happens on this side and cannot slow a tick.
"""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import piezod.errors
from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, ControlLoop, RingLog, RingReader, check_ready, real_time
from piezod.daemon.assembly import Work, make_loop, make_rate_keeper, make_segment, opened_link
from piezod.errors import PiezodError
from piezod.model import Model
from piezod.transport import ExchangeResult

LOOK_EVERY_S = 0.1
_PR_SET_PDEATHSIG = 1  # prctl(2): the signal that comes when the parent has died


@dataclass
class Outcome:
    """What a session came to."""

    ticks: int = 0
    missed: int = 0
    failed_exchanges: int = 0
    results: dict[str, int] = field(default_factory=dict)
    fault: str = ""
    stopped: bool = False
    warnings: list[str] = field(default_factory=list)
    resident_kib: int = 0


class Session:
    """A control process and the view of its ring log.

    Parameters
    ----------
    bench, model, folder
        What `load` read, and the folder that relative paths start from.
    works
        Driven one after the other; none: the bench is only read, until stopped.
    """

    def __init__(self, bench: BenchConfig, model: Model | None, folder: Path, works: list[Work]) -> None:
        context = multiprocessing.get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_control, args=(bench, model, folder, works, theirs), daemon=False)
        self._ring_path = bench.ring_log_path
        self._theirs: Connection | None = theirs
        self.outcome = Outcome()

    def start(self) -> None:
        """Start the control process and wait until it is connected.

        Raises
        ------
        PiezodError
            What the control process found wrong before anything was written.
        """
        self._process.start()
        if self._theirs is not None:
            self._theirs.close()
            self._theirs = None
        self._take(self._receive())
        self._reader = RingReader(self._ring_path)

    def follow(self) -> Iterator[NDArray[np.void]]:
        """New rows of the ring log, about ten times a second, until the control process ends.

        Raises
        ------
        PiezodError
            What ended the control process before its work was done.
        """
        while not self._ours.poll(LOOK_EVERY_S):
            yield self._reader.read()
        try:
            self._take(self._receive())
        finally:
            self._process.join()
        yield self._reader.read()

    def stop(self) -> None:
        """Ask for a ramp down; a second time: in haste."""
        with contextlib.suppress(ProcessLookupError):
            if self._process.pid is not None and self._process.is_alive():
                os.kill(self._process.pid, signal.SIGTERM)

    def close(self) -> None:
        """Ramp down if it still drives, and wait for the end."""
        if self._process.pid is None:
            return
        self.stop()
        self._process.join(timeout=30)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._ring_path.unlink(missing_ok=True)

    def _receive(self) -> tuple[str, Any]:
        try:
            kind, content = self._ours.recv()
        except EOFError:
            self._process.join()
            return "error", ("PiezodError", f"the control process ended with code {self._process.exitcode}")
        return kind, content

    def _take(self, message: tuple[str, Any]) -> None:
        kind, content = message
        if kind == "error":
            name, text = content
            self._process.join()
            raise getattr(piezod.errors, name, PiezodError)(text)
        if kind == "done":
            self.outcome = content


def _control(bench: BenchConfig, model: Model | None, folder: Path, works: list[Work], pipe: Connection) -> None:
    """The control process; ramps down when the one that started it dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            outcome = _drive(bench, model, folder, works, pipe)
        outcome.warnings = [str(warning.message) for warning in caught]
        with contextlib.suppress(BrokenPipeError):
            pipe.send(("done", outcome))
    except PiezodError as error:
        pipe.send(("error", (type(error).__name__, str(error))))


def _drive(bench: BenchConfig, model: Model | None, folder: Path, works: list[Work], pipe: Connection) -> Outcome:
    with opened_link(bench) as link, contextlib.ExitStack() as stack:
        clock = make_rate_keeper(bench, link)
        segments = [make_segment(work, bench, model, link, folder) for work in works]
        for segment in segments:
            stack.callback(segment.reference.close)
            segment.compensator.commit(segment.compensator.plan(0.0))
            segment.compensator.reset()
        if works:
            check_ready(bench, link)
        ring = RingLog(bench.ring_log_path, round(bench.daemon.ring_seconds * bench.rate_Hz))
        stack.callback(ring.close)
        loop = make_loop(bench, link, clock, ring)
        signal.signal(signal.SIGTERM, lambda *_: loop.request_stop())
        pipe.send(("ready", None))
        with real_time(bench.real_time):
            fault = _work(loop, segments)
        results = {result.name.lower(): link.counts[result] for result in ExchangeResult if link.counts[result]}
        return Outcome(
            ticks=loop.counts.ticks,
            missed=clock.missed,
            failed_exchanges=loop.counts.failed_exchanges,
            results=results,
            fault="" if fault is Cause.NONE else CAUSE_TEXT[fault],
            stopped=loop.stopped,
            resident_kib=_resident_kib(),
        )


def _work(loop: ControlLoop, segments: list[Any]) -> Cause:
    if not segments:
        loop.watch()
    for segment in segments:
        fault = loop.drive(segment)
        if fault is not Cause.NONE or loop.stopped:
            return fault
    return Cause.NONE


def _resident_kib() -> int:
    """Resident memory of this process now [KiB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024
