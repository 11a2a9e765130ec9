"""The ring-log reader that all viewers share. It continues when the daemon restarts.

The ring is a file in shared memory. A daemon that starts replaces the file. The reader opens the new file
when the device or inode number changes. The control process is not involved.
"""

import time
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, RingReader, State
from piezod.errors import PiezodError
from piezod.recording.age import ValueAge
from piezod.report.figures.durations import RecentDurations
from piezod.report.live.curves import Curves, Rows

WINDOW_s = 30.0  # length of curves over time and histograms
SEGMENT_s = 0.05  # drawn by its smallest and its largest value
LOOP_POINTS = 2400
SHORTEST_LOOP_s, LONGEST_LOOP_s = 20.0, 600.0
MOST_EVENTS = 50


@dataclass(frozen=True)
class Event:
    """A change of state or another event, with its time of day [s since 1970, UTC]."""

    wall_s: float
    name: str
    text: str


class Feed:
    """Curves, durations, events and status of a bench, as of the last `update`.

    Parameters
    ----------
    bench
        Configuration with the path of the ring log.
    """

    def __init__(self, bench: BenchConfig) -> None:
        self.bench = bench
        self._path = bench.ring_log_path
        self._ring: RingReader | None = None
        self._identity: tuple[int, int] | None = None
        self._to_wall_ms = 0.0
        self._age = ValueAge()
        self._noted: tuple[int, int] | None = None  # state and cause of the last event
        recent = round(WINDOW_s * bench.rate_Hz)
        self.curves = Curves(bench.rate_Hz, SEGMENT_s, WINDOW_s, _loop_s(bench), LOOP_POINTS)
        self.lateness, self.exchange = RecentDurations(recent), RecentDurations(recent)
        self.events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self.event_count = 0
        self.last: np.void | None = None
        self.status: dict[str, Any] | None = None
        self.problem = ""

    @property
    def stale(self) -> bool:
        """Whether the device gave the values so long ago that they are no present values."""
        return self._age.is_stale(self.bench.dt_s)

    def update(self) -> None:
        """Read the new rows of the ring log."""
        self._open_new_ring()
        if self._ring is None:
            return
        dropped = self._ring.dropped
        rows = self._ring.read()
        if self._ring.dropped > dropped:
            self._note("not seen", f"{self._ring.dropped - dropped} ticks were overwritten before this page read them")
        if rows.size:
            self._add(rows)

    def set_status(self, status: dict[str, Any] | None, problem: str) -> None:
        """Store the status of the daemon.

        Parameters
        ----------
        status
            Answer of the daemon to the command `status`; None if it did not answer.
        problem
            Reason why it did not answer; empty if it did.
        """
        self.status, self.problem = status, problem

    def _open_new_ring(self) -> None:
        """Open the ring log, and again after a restart of the daemon."""
        try:
            status = self._path.stat()
        except OSError:
            return  # the open ring is read to its end
        identity = status.st_dev, status.st_ino
        if identity == self._identity:
            return
        try:
            reader = RingReader(self._path)
        except PiezodError:
            return  # the daemon is still writing the header
        if self._identity is not None:
            self._note("restarted", "the daemon was started again")
        self._ring, self._identity = reader, identity
        reader.seek(max(0, reader.waiting - round(WINDOW_s * self.bench.rate_Hz)))
        self._to_wall_ms = (time.time_ns() - time.clock_gettime_ns(time.CLOCK_BOOTTIME)) * 1e-6
        self._noted = None
        self.curves.start_new_ring()
        self.lateness.clear()
        self.exchange.clear()

    def _add(self, rows: Rows) -> None:
        self._age.add(rows)
        self.last = rows[-1].copy()
        self.curves.add(rows, self._to_wall_ms + 1000.0 * time.localtime().tm_gmtoff)  # axes show the local time
        self.lateness.add(rows["lateness_ns"])
        self.exchange.add(rows["exchange_ns"])
        changed = (np.diff(rows["state"]) != 0) | (np.diff(rows["cause"]) != 0)
        for row in (rows[0], *rows[1:][changed]):
            state, cause = int(row["state"]), int(row["cause"])
            if (state, cause) != self._noted:
                self._noted = state, cause
                wall_s = (row["time_ns"] * 1e-6 + self._to_wall_ms) * 1e-3
                self._note(State(state).name, CAUSE_TEXT[Cause(cause)], wall_s)

    def _note(self, name: str, text: str, wall_s: float | None = None) -> None:
        self.event_count += 1
        self.events.append(Event(time.time() if wall_s is None else wall_s, name, text))


def _loop_s(bench: BenchConfig) -> float:
    """Two periods of the reference, within limits; the lower limit if the reference has no frequency."""
    frequency_Hz = getattr(bench.reference, "frequency_Hz", None)
    loop_s = SHORTEST_LOOP_s if frequency_Hz is None else 2.0 / frequency_Hz
    return float(np.clip(loop_s, SHORTEST_LOOP_s, LONGEST_LOOP_s))
