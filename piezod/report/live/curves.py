"""Curves of the newest ring-log rows, thinned for a screen, in buffers of fixed capacity."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.control import State
from piezod.control.states import DRIVING
from piezod.recording.ticks import GOOD, pair_rows
from piezod.report.figures.thinning import envelope, envelope_times

Rows = NDArray[np.void]

OVER_TIME = ("time_ms", "reference_N", "force_N", "error_N", "voltage_V")
LOOP = ("voltage_V", "force_N")
_FOLLOWING = (State.RUNNING, State.HOLD)


class RecentPoints:
    """The newest points of several columns. Points are numbered from the first that was added."""

    def __init__(self, names: tuple[str, ...], capacity: int) -> None:
        self.capacity = capacity
        self.total = 0
        self._columns = {name: np.empty(0) for name in names}

    def add(self, columns: Mapping[str, Array]) -> None:
        """Append points, and drop the oldest that exceed the capacity."""
        self.total += next(iter(columns.values())).size
        self._columns = {
            name: np.concatenate((values, columns[name]))[-self.capacity :] for name, values in self._columns.items()
        }

    def since(self, number: int) -> dict[str, Array]:
        """Points from this number on that the buffer still holds."""
        count = min(max(0, self.total - number), self.capacity)
        return {name: values[values.size - min(count, values.size) :] for name, values in self._columns.items()}


class Curves:
    """Curves over time and the force-voltage loop, updated from ring-log rows.

    Parameters
    ----------
    rate_Hz
        Tick rate [Hz].
    segment_s
        Length of a segment of the curves over time [s]. Its smallest and its largest value are drawn.
    window_s
        Length of the curves over time [s].
    loop_s, loop_points
        Length [s] and number of points of the loop.
    """

    def __init__(self, rate_Hz: float, segment_s: float, window_s: float, loop_s: float, loop_points: int) -> None:
        self._length = max(1, round(segment_s * rate_Hz))
        self._every = max(1, round(loop_s * rate_Hz / loop_points))
        self._phase = 0
        segments = window_s * rate_Hz / self._length
        self.over_time = RecentPoints(OVER_TIME, int(min(2, self._length) * segments))
        self.loop = RecentPoints(LOOP, loop_points)
        self._pending: Rows | None = None

    def start_new_ring(self) -> None:
        """Discard rows of the old ring that fill no segment. Points stay."""
        self._pending = None

    def add(self, rows: Rows, to_wall_ms: float) -> None:
        """Append rows.

        Parameters
        ----------
        rows
            Ring-log rows, in the order in which they were written.
        to_wall_ms
            Offset from the clock of the rows to the time of day [ms].
        """
        joined = rows if self._pending is None else np.concatenate((self._pending, rows))
        count = (joined.size - 1) // self._length * self._length  # each row answers the command of the row before
        if count <= 0:
            self._pending = joined.copy()
            return
        self._pending = joined[count:].copy()
        commands, answers = pair_rows(joined[: count + 1])
        points = 2 * (count // self._length) if self._length > 1 else count
        time_ms = answers["time_ns"] * 1e-6 + to_wall_ms
        columns = {"time_ms": envelope_times(time_ms, points)}
        for name, values in _values(commands, answers).items():
            columns[name] = envelope(values, points)
        self.over_time.add(columns)
        selected = (np.arange(count) + self._phase) % self._every == 0
        self._phase = (self._phase + count) % self._every
        selected &= np.isin(commands["state"], DRIVING) & (answers["result"] == GOOD)
        self.loop.add({"voltage_V": commands["voltage_V"][selected], "force_N": answers["force_N"][selected]})


def _values(commands: Rows, answers: Rows) -> dict[str, Array]:
    """Values of each curve over time at each answer; nan where unknown."""
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
