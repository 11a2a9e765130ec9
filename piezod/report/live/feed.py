"""The one reader that all viewers share: it follows the ring log, also across restarts of the daemon.

The ring is a file in shared memory: a daemon that starts makes a new one, under the same name. The reader looks at the
file's identity and changes over. Nothing is asked of the control process; the daemon's parent is asked for its status
once a second, over its socket.
"""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, RingReader, State
from piezod.errors import PiezodError
from piezod.report.figures.durations import RecentDurations
from piezod.report.live.curves import Curves, Rows

WINDOW_s, BUCKET_s = 30.0, 0.05
LOOP_POINTS = 2400
SHORTEST_LOOP_s, LONGEST_LOOP_s = 20.0, 600.0
QUIET_AFTER_s = 1.0
MOST_EVENTS = 50


@dataclass(frozen=True)
class Event:
    """Something that happened, at a time of day [s since 1970, UTC]."""

    wall_s: float
    name: str
    text: str


class Feed:
    """What is known of a bench, as of the last look.

    Parameters
    ----------
    bench
        Says where its ring log lies.
    clock
        Monotonic [s].
    """

    def __init__(self, bench: BenchConfig, clock: Callable[[], float] = time.monotonic) -> None:
        self.bench = bench
        self._clock = clock
        self._path = bench.ring_log_path
        self._ring: RingReader | None = None
        self._identity: tuple[int, int] | None = None
        self._to_wall_ms = 0.0
        self._seen_s = -np.inf
        self._told: tuple[int, int] | None = None
        recent = round(WINDOW_s * bench.rate_Hz)
        self.curves = Curves(bench.rate_Hz, BUCKET_s, WINDOW_s, _loop_s(bench), LOOP_POINTS)
        self.lateness, self.exchange = RecentDurations(recent), RecentDurations(recent)
        self.events: deque[Event] = deque(maxlen=MOST_EVENTS)
        self.happened = 0
        self.last: np.void | None = None
        self.status: dict[str, Any] | None = None
        self.problem = ""

    @property
    def quiet(self) -> bool:
        """Whether no tick has come for a second, or for three ticks of a slow bench."""
        return self._clock() - self._seen_s > max(QUIET_AFTER_s, 3.0 * self.bench.dt_s)

    def look(self) -> None:
        """Take in what is new."""
        self._change_over()
        if self._ring is None:
            return
        dropped = self._ring.dropped
        rows = self._ring.read()
        if self._ring.dropped > dropped:
            self._note("not seen", f"{self._ring.dropped - dropped} ticks were overwritten before this page read them")
        if rows.size:
            self._take(rows)

    def _change_over(self) -> None:
        """Open the ring, and another one that has taken its place."""
        try:
            found = self._path.stat()
        except OSError:
            return  # what is open is read to its end
        identity = found.st_dev, found.st_ino
        if identity == self._identity:
            return
        try:
            ring = RingReader(self._path)
        except PiezodError:
            return  # it is being made
        if self._identity is not None:
            self._note("restarted", "the daemon was started again")
        self._ring, self._identity = ring, identity
        ring.seek(max(0, ring.waiting - round(WINDOW_s * self.bench.rate_Hz)))
        self._to_wall_ms = (time.time_ns() - time.clock_gettime_ns(time.CLOCK_BOOTTIME)) * 1e-6
        self._told = None
        self.curves.begin()
        self.lateness.clear()
        self.exchange.clear()

    def _take(self, rows: Rows) -> None:
        self._seen_s = self._clock()
        self.last = rows[-1].copy()
        self.curves.add(rows, self._to_wall_ms + 1000.0 * time.localtime().tm_gmtoff)  # axes say the local time
        self.lateness.add(rows["lateness_ns"])
        self.exchange.add(rows["exchange_ns"])
        changed = (np.diff(rows["state"]) != 0) | (np.diff(rows["cause"]) != 0)
        for row in (rows[0], *rows[1:][changed]):
            told = int(row["state"]), int(row["cause"])
            if told != self._told:
                self._told = told
                wall_s = (row["time_ns"] * 1e-6 + self._to_wall_ms) * 1e-3
                self._note(State(told[0]).name, CAUSE_TEXT[Cause(told[1])], wall_s)

    def _note(self, name: str, text: str, wall_s: float | None = None) -> None:
        self.happened += 1
        self.events.append(Event(time.time() if wall_s is None else wall_s, name, text))

    def answered(self, status: dict[str, Any] | None, problem: str) -> None:
        """What the daemon said about itself, or why it said nothing."""
        self.status, self.problem = status, problem


def _loop_s(bench: BenchConfig) -> float:
    """Two periods of the reference, where it has one."""
    frequency_Hz = getattr(bench.reference, "frequency_Hz", None)
    wanted_s = SHORTEST_LOOP_s if frequency_Hz is None else 2.0 / frequency_Hz
    return float(np.clip(wanted_s, SHORTEST_LOOP_s, LONGEST_LOOP_s))
