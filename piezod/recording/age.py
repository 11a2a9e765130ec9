"""Age of the values of a bench: how long ago its device gave them. Every output of the values uses it."""

import numpy as np
from numpy.typing import NDArray

from piezod.recording.ticks import GOOD
from piezod.runtime import clock

STALE_AFTER_S = 1.0  # age from which values count as stale [s], at a rate of some ticks a second
STALE_TICKS = 3.0  # limit for a slower bench [ticks]


class ValueAge:
    """Time since the last good exchange with the device. A row of a failed exchange has no values."""

    def __init__(self) -> None:
        self._good_ns: int | None = None

    def add(self, rows: NDArray[np.void]) -> None:
        """Look at new rows of the ring log; their `time_ns` is of the clock CLOCK_BOOTTIME."""
        good_ns = rows["time_ns"][rows["result"] == GOOD]
        if good_ns.size:
            self._good_ns = int(good_ns[-1])

    @property
    def age_s(self) -> float | None:
        """Age of the values [s]; None: there was no good exchange."""
        return None if self._good_ns is None else 1e-9 * (clock.boot_ns() - self._good_ns)

    def is_stale(self, dt_s: float) -> bool:
        """Whether the values are no present values; True if there are none.

        Parameters
        ----------
        dt_s
            Time between two ticks [s].
        """
        age_s = self.age_s
        return age_s is None or age_s > max(STALE_AFTER_S, STALE_TICKS * dt_s)
