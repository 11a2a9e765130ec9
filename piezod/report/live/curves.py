"""Rows of the ring log as curves for a screen: a short memory that does not grow, whatever the rate."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from piezod.control import State
from piezod.recording.ticks import GOOD
from piezod.report.figures.thinning import envelope, envelope_times

Array = NDArray[np.float64]
Rows = NDArray[np.void]

OVER_TIME = ("time_ms", "reference_N", "force_N", "error_N", "voltage_V")
LOOP = ("voltage_V", "force_N")
_DRIVING = (State.ARMING, State.RUNNING, State.HOLD, State.RAMP_DOWN)
_FOLLOWING = (State.RUNNING, State.HOLD)


class Table:
    """The newest points of some columns, numbered from the first that ever was.

    Parameters
    ----------
    names
        Of the columns.
    most
        Points kept.
    """

    def __init__(self, names: tuple[str, ...], most: int) -> None:
        self.most = most
        self.total = 0
        self._columns = {name: np.empty(0) for name in names}

    def add(self, columns: Mapping[str, Array]) -> None:
        """Append points; the oldest go."""
        self.total += next(iter(columns.values())).size
        self._columns = {
            name: np.concatenate((kept, columns[name]))[-self.most :] for name, kept in self._columns.items()
        }

    def since(self, number: int) -> dict[str, Array]:
        """Points from this number on, as far as they are kept."""
        wanted = min(max(0, self.total - number), self.most)
        return {name: kept[kept.size - min(wanted, kept.size) :] for name, kept in self._columns.items()}


class Curves:
    """What the figures show, made from rows as they come.

    Parameters
    ----------
    rate_Hz
        Of the ticks.
    bucket_s
        Stretch of time that is shown by its smallest and its largest value [s].
    window_s
        Time that the curves over time go back [s].
    loop_s, loop_points
        Time that the loop goes back [s], and how many points it has.
    """

    def __init__(self, rate_Hz: float, bucket_s: float, window_s: float, loop_s: float, loop_points: int) -> None:
        self._length = max(1, round(bucket_s * rate_Hz))
        self._every = max(1, round(loop_s * rate_Hz / loop_points))
        self._phase = 0
        buckets = window_s * rate_Hz / self._length
        self.over_time = Table(OVER_TIME, int(min(2, self._length) * buckets))
        self.loop = Table(LOOP, loop_points)
        self._rest: Rows | None = None

    def begin(self) -> None:
        """Start over with another ring; points that were shown stay."""
        self._rest = None

    def add(self, rows: Rows, to_wall_ms: float) -> None:
        """Take in rows.

        Parameters
        ----------
        rows
            In the order in which they were written.
        to_wall_ms
            What turns their clock into the time of day [ms].
        """
        joined = rows if self._rest is None else np.concatenate((self._rest, rows))
        whole = (joined.size - 1) // self._length * self._length  # the row in front holds the command answered first
        if whole <= 0:
            self._rest = joined.copy()
            return
        self._rest = joined[whole:].copy()
        commands, answers = joined[:whole], joined[1 : whole + 1]
        points = 2 * (whole // self._length) if self._length > 1 else whole
        time_ms = answers["time_ns"] * 1e-6 + to_wall_ms
        table = {"time_ms": envelope_times(time_ms, points)}
        for name, values in _values(commands, answers).items():
            table[name] = envelope(values, points)
        self.over_time.add(table)
        chosen = (np.arange(whole) + self._phase) % self._every == 0
        self._phase = (self._phase + whole) % self._every
        chosen &= np.isin(commands["state"], _DRIVING) & (answers["result"] == GOOD)
        self.loop.add({"voltage_V": commands["voltage_V"][chosen], "force_N": answers["force_N"][chosen]})


def _values(commands: Rows, answers: Rows) -> dict[str, Array]:
    """Every curve at every answer; what is not known there is nan."""
    good = answers["result"] == GOOD
    followed = np.isin(commands["state"], _FOLLOWING)
    force = np.where(good, answers["force_N"], np.nan)
    reference = np.where(followed, commands["reference_N"], np.nan)
    return {
        "reference_N": reference,
        "force_N": force,
        "error_N": force - reference,
        "voltage_V": commands["voltage_V"].astype(np.float64),
    }
