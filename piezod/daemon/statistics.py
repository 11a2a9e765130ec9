"""Sums over the ticks in the ring log, in constant memory: for log, status and metrics."""

from collections.abc import Callable
from math import isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from piezod.control import CAUSE_TEXT, Cause, State
from piezod.control.states import DRIVING
from piezod.recording.age import ValueAge
from piezod.recording.ticks import GOOD, pair_rows
from piezod.session.history import is_tracking
from piezod.transport import ExchangeResult

BOUNDS_S = (1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 5e-2, 0.1)
"""Upper bounds of the histogram bins [s]."""


class TrackingError:
    """Difference of force and reference while a reference is followed.

    Attributes
    ----------
    max_N
        Largest absolute error [N].
    """

    def __init__(self) -> None:
        self.ticks = 0
        self.max_N = 0.0
        self._sum_of_squares = 0.0
        self._before: NDArray[np.void] | None = None

    @property
    def rms_N(self) -> float:
        """Root mean square error [N]; nan before the first tick."""
        return sqrt(self._sum_of_squares / self.ticks) if self.ticks else float("nan")

    def skip(self) -> None:
        """Forget the last row: the next reading does not belong to its command."""
        self._before = None

    def add(self, rows: NDArray[np.void]) -> None:
        """Add new rows of the ring log."""
        if not rows.size:
            return
        commands, readings = pair_rows(rows, self._before)
        self._before = rows[-1:].copy()
        tracking = is_tracking(commands, readings)
        error = readings["force_N"][tracking] - commands["reference_N"][tracking]
        if error.size:
            self.ticks += int(error.size)
            self._sum_of_squares += float(np.sum(error**2))
            self.max_N = max(self.max_N, float(np.abs(error).max()))


class DurationHistogram:
    """Histogram of durations with the bins of `BOUNDS_S`.

    Attributes
    ----------
    counts
        Number of durations per bin, shape (len(BOUNDS_S) + 1,); the last bin has no upper bound.
    sum_s
        Sum of all durations [s].
    """

    def __init__(self) -> None:
        self.counts = np.zeros(len(BOUNDS_S) + 1, dtype=np.int64)
        self.sum_s = 0.0

    def add(self, values_ns: NDArray[np.int64]) -> None:
        """Add durations [ns]."""
        values_s = values_ns * 1e-9
        bins = np.searchsorted(BOUNDS_S, values_s)
        self.counts += np.bincount(bins, minlength=self.counts.size)
        self.sum_s += float(values_s.sum())


class TickStatistics:
    """Counts and sums over the rows of one or several sessions.

    Parameters
    ----------
    on_transition
        Called with state, cause and row at every change of the state.

    Attributes
    ----------
    last
        Last row of the session; None before its first row.
    age
        Age of the values.
    ticks, missed
        Number of ticks that ran, and of ticks that were skipped.
    results
        Number of exchanges by `ExchangeResult`.
    faults
        Number of latched faults by cause.
    transitions
        Number of changes of the state.
    was_driving
        Whether a voltage was driven at any time.
    lateness, exchange
        Wake-up after the deadline, and time from wake-up to the evaluated reading.
    tracking
        Error of the force while a reference is followed.
    """

    def __init__(self, on_transition: Callable[[State, Cause, np.void], None]) -> None:
        self._on_transition = on_transition
        self._state = State.DISARMED
        self._next_tick: int | None = None
        self.last: np.void | None = None
        self.age = ValueAge()
        self.ticks = self.missed = 0
        self.results = np.zeros(len(ExchangeResult), dtype=np.int64)
        self.faults: dict[str, int] = {}
        self.transitions = 0
        self.was_driving = False
        self.lateness, self.exchange = DurationHistogram(), DurationHistogram()
        self.tracking = TrackingError()

    def begin(self) -> None:
        """Begin a new session, whose tick numbers begin again; the sums stay."""
        self.skip_lost_rows()
        self.last = None

    def skip_lost_rows(self) -> None:
        """Note that rows were lost before the next one: they are no missed ticks, and give no tracking error."""
        self._next_tick = None
        self.tracking.skip()

    def add(self, rows: NDArray[np.void]) -> None:
        """Add new rows of the ring log."""
        if not rows.size:
            return
        self.last = rows[-1].copy()
        self.age.add(rows)
        self.ticks += int(rows.size)
        first = int(rows["tick"][0]) if self._next_tick is None else self._next_tick
        self._next_tick = int(rows["tick"][-1]) + 1
        self.missed += max(0, self._next_tick - first - int(rows.size))
        self.results += np.bincount(rows["result"], minlength=self.results.size)
        self.lateness.add(rows["lateness_ns"])
        self.exchange.add(rows["exchange_ns"])
        self.was_driving = self.was_driving or bool(np.isin(rows["state"], DRIVING).any())
        self.tracking.add(rows)
        for row in rows[np.flatnonzero(np.diff(rows["state"], prepend=self._state))]:
            self._state = State(row["state"])
            self.transitions += 1
            if self._state is State.FAULT:
                name = Cause(row["cause"]).name.lower()
                self.faults[name] = self.faults.get(name, 0) + 1
            self._on_transition(self._state, Cause(row["cause"]), row)

    @property
    def state(self) -> State:
        """State of the last row."""
        return self._state

    def as_dict(self) -> dict[str, object]:
        """State, values and counts, for `piezod status`; a value that the device does not have is None."""
        row = self.last
        cause = Cause.NONE if row is None else Cause(row["cause"])
        names = ("reference_N", "voltage_V", "force_N", "readback_V", "temperature_C")
        values = {name: _finite(None if row is None else float(row[name])) for name in names}
        return {
            "state": self._state.name,
            "cause": CAUSE_TEXT[cause],
            "fault": CAUSE_TEXT[cause] if self._state is State.FAULT else "",
            **values,
            "ticks": self.ticks,
            "missed": self.missed,
            "failed_exchanges": int(self.results.sum() - self.results[GOOD]),
            "results": {result.name.lower(): int(self.results[result]) for result in ExchangeResult},
            "tracking": {
                "ticks": self.tracking.ticks,
                "rms_error_N": _finite(self.tracking.rms_N),
                "max_error_N": self.tracking.max_N,
            },
        }


def _finite(value: float | None) -> float | None:
    return value if value is not None and isfinite(value) else None
