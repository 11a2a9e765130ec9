"""Leaky counts: wrong samples of an interlock, counted so that a right sample does not start the count anew.

A wrong sample adds `WRONG` to the level, a right one takes 1 away. Samples that are wrong in a row trip after the
configured number of them. Those that are wrong more often than once in `WRONG + 1` trip too, later.

The level, and the sums of it, stand in counters of the ring log, where the daemon reads them for status and metrics.
They are written when they change, so a tick whose samples are right writes nothing.
"""

from collections.abc import Sequence
from enum import IntEnum

WRONG = 3  # weight of a wrong sample: samples that are wrong more often than one in four are no spikes
FIRST_COUNTER = 8
"""Number of the first counter of the ring log that belongs to the interlocks; a live reference has those before."""

_SAMPLES, _LEVEL, _HIGHEST, _TRIPS_AT = range(4)
CELLS = 4  # counters of one interlock


class CountedInterlock(IntEnum):
    """Interlocks with a leaky count; the number gives the place in the counters of the ring log."""

    FORCE = 0
    """Force outside its limits, or changed too fast."""
    READBACK = 1
    TRACKING = 2
    """Its level is a time [ns]."""
    OUTPUT = 3
    """Output reported as off."""
    THERMOMETER = 4
    """Implausible temperature."""
    EXCHANGES = 5
    """Exchange failed, late or with an invalid reading."""
    MISSED_TICKS = 6


class LeakyCount:
    """Leaky count of one interlock.

    Parameters
    ----------
    trips_at
        Level that trips, at least 0.

    Attributes
    ----------
    level
        Level now, at least 0.
    """

    __slots__ = ("_cells", "_trips_at", "level")

    def __init__(self, trips_at: int = 1) -> None:
        self._cells = memoryview(bytearray(8 * CELLS)).cast("Q")
        self.level = 0
        self.trips_at = trips_at

    @property
    def trips_at(self) -> int:
        """Level that trips; a new one keeps the level."""
        return self._trips_at

    @trips_at.setter
    def trips_at(self, level: int) -> None:
        self._trips_at = self._cells[_TRIPS_AT] = level

    def show_in(self, cells: "memoryview[int]") -> None:
        """Keep the numbers in other cells from now on.

        Parameters
        ----------
        cells
            Counters of the ring log, shape (`CELLS`,).
        """
        cells[:] = self._cells
        self._cells = cells

    def clear(self) -> None:
        """Set the level, and the highest one, to 0; the number of wrong samples stays."""
        self.level = self._cells[_LEVEL] = self._cells[_HIGHEST] = 0

    def add(self, amount: int = WRONG) -> bool:
        """Count a wrong sample; the result is whether the level trips.

        Parameters
        ----------
        amount
            What it adds to the level, at least 0.
        """
        self.level += amount
        cells = self._cells
        cells[_SAMPLES] += 1
        cells[_LEVEL] = self.level
        cells[_HIGHEST] = max(cells[_HIGHEST], self.level)
        return self.level >= self._trips_at

    def leak(self, amount: int = 1) -> None:
        """Count a right sample; call it where the level is above 0.

        Parameters
        ----------
        amount
            What it takes from the level, at least 0.
        """
        self.level = self._cells[_LEVEL] = max(self.level - amount, 0)


def cells_of(counters: "memoryview[int]", interlock: CountedInterlock) -> "memoryview[int]":
    """Counters of one interlock.

    Parameters
    ----------
    counters
        Counters of the ring log.
    """
    first = FIRST_COUNTER + CELLS * interlock
    return counters[first : first + CELLS]


def interlock_counts(counters: Sequence[int]) -> dict[str, dict[str, float]]:
    """Counts by the name of the interlock, in lower case; empty without counters.

    Each has `wrong`, the wrong samples since the start of the control process; and `level` and `highest`, the level
    now and its maximum since arming, as shares of the level that trips.

    Parameters
    ----------
    counters
        Counters of the ring log.
    """
    if len(counters) < FIRST_COUNTER + CELLS * len(CountedInterlock):
        return {}
    counts = {}
    for interlock in CountedInterlock:
        first = FIRST_COUNTER + CELLS * interlock
        samples, level, highest, trips_at = counters[first : first + CELLS]
        shares = (value / trips_at if trips_at else 0.0 for value in (level, highest))
        counts[interlock.name.lower()] = dict(zip(("wrong", "level", "highest"), (samples, *shares), strict=True))
    return counts
