"""Where a reading stands still though its drive moves: a sensor that froze, or one at the end of its range.

Not all that stands still is stuck. A command dwells; a coarse converter gives one value over a stretch of the drive;
dry friction holds a stack after each reversal. So a run of identical values counts only where the drive moves farther
than it ordinarily does between two changes of the reading. A noisy reading never repeats itself for long: that is proof
enough. One without noise must jump when it is let go, stay while the drive goes on outwards, or ignore half its swing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.recording.stretches import Array, Stretch, long_runs, pairs

SHORTEST = 5
"""Samples of a run that can count: fewer are no matter to a fit."""

UNUSUAL = 10
"""How many times farther than ordinarily the drive moves, or the reading jumps, where a reading is stuck."""

SMALLEST_MOVE = 0.005
"""Share of its swing that the drive must move: less is no matter to a fit."""

TRIMMED = 10
"""Of a run, one part in so many at either end is left out of the drive's move: a reading may follow late."""

ALTERNATING = 0.3
"""Share of changes of sign from one step of a reading to the next above which it is noisy; white noise has 2/3."""

WINDOWS, WINDOW, FEWEST_RUNS = 16, 2**16, 100
"""How much of a long recording is looked at to learn what is ordinary."""

ANSWERS = 0.3
"""Correlation with the drive from which on a reading can be said to answer it at all."""

Runs = tuple[NDArray[np.intp], NDArray[np.intp]]


@dataclass(frozen=True)
class Stuck:
    """Stretches in which a reading is not believed.

    Parameters
    ----------
    frozen
        It stands still within its range.
    at_largest, at_smallest
        It stands at its largest or smallest value: it is cut off there.
    """

    frozen: list[Stretch]
    at_largest: list[Stretch]
    at_smallest: list[Stretch]

    @property
    def stretches(self) -> list[Stretch]:
        """All of them."""
        return [*self.frozen, *self.at_largest, *self.at_smallest]


@dataclass(frozen=True)
class _Ordinary:
    """What reading and drive ordinarily do.

    Parameters
    ----------
    move
        Of the drive, while the reading stands still: what half of all its travel is made of.
    drive_noise
        Standard deviation.
    step
        Median of the reading's steps.
    noisy
        Whether the reading hardly ever repeats a value.
    together
        Correlation of reading and drive.
    """

    move: float
    drive_noise: float
    step: float
    noisy: bool
    together: float


def stuck(values: Array, drive: Array) -> Stuck:
    """Find the stretches over which a reading does not answer its drive.

    Parameters
    ----------
    values
        The reading, shape (N,); nan where it is missing.
    drive
        What moves it, shape (N,).
    """
    low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=-np.inf)
    swing = float(np.nanmax(drive, initial=-np.inf) - np.nanmin(drive, initial=np.inf))
    if not (low < high and swing > 0.0) or not ((values > low) & (values < high)).any():
        return Stuck([], [], [])  # a constant and a flag have no range to stand still in
    ordinary = _ordinary(values, drive)
    runs = long_runs(values, SHORTEST)
    if abs(ordinary.together) < ANSWERS or not runs[0].size:
        return Stuck([], [], [])
    limit = max(SMALLEST_MOVE * swing + UNUSUAL * ordinary.drive_noise, UNUSUAL * ordinary.move)
    bottom, top = _range(drive, *runs)
    moved = top - bottom > limit
    outwards = (top - drive[runs[0]] > limit, drive[runs[0]] - bottom > limit)
    beyond_top, beyond_bottom = outwards if ordinary.together > 0.0 else outwards[::-1]
    proved = _proved(values, drive, runs, limit, ordinary) | (moved & ordinary.noisy)
    at_top, at_bottom = values[runs[0]] == high, values[runs[0]] == low
    largest = _rail(at_top, moved, proved | beyond_top)
    smallest = _rail(at_bottom, moved, proved | beyond_bottom)
    kinds = (proved & ~at_top & ~at_bottom, largest, smallest)
    return Stuck(*(pairs(runs[0][kind], runs[1][kind]) for kind in kinds))


def _rail(there: NDArray[np.bool_], moved: NDArray[np.bool_], proved: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which runs at an extreme value are cut off: all over which the drive moves, once one of them is proved to be."""
    result: NDArray[np.bool_] = there & (moved | proved) & (there & proved).any()
    return result


def _proved(values: Array, drive: Array, runs: Runs, limit: float, ordinary: _Ordinary) -> NDArray[np.bool_]:
    """Whether a reading without noise jumps after a run, or ignored half the drive's swing in it.

    The ends of a run do not count here: a reading may follow late.
    """
    starts, stops = runs
    trimmed = (stops - starts) // TRIMMED
    bottom, top = _range(drive, starts + trimmed, stops - trimmed)
    jumps = np.abs(values[np.minimum(stops, values.size - 1)] - values[stops - 1]) > UNUSUAL * ordinary.step
    half = 0.5 * (np.nanmax(drive) - np.nanmin(drive))
    result: NDArray[np.bool_] = (jumps & (top - bottom > limit)) | (top - bottom > half)
    return result


def _range(drive: Array, starts: NDArray[np.intp], stops: NDArray[np.intp]) -> tuple[Array, Array]:
    """Smallest and largest drive within each stretch."""
    places = np.column_stack((starts, np.minimum(stops, drive.size - 1))).ravel()
    return np.fmin.reduceat(drive, places)[::2], np.fmax.reduceat(drive, places)[::2]


def _ordinary(values: Array, drive: Array) -> _Ordinary:
    size = WINDOW
    parts = _windows(values.size, size)
    while (found := _statistics(values, drive, parts)) is None and size * WINDOWS < values.size:
        size *= 8
        parts = _windows(values.size, size)
    return found or _Ordinary(np.inf, 0.0, np.inf, noisy=False, together=0.0)


def _windows(samples: int, size: int) -> list[slice]:
    """Windows spread over a recording, or all of it."""
    if samples <= WINDOWS * size:
        return [slice(0, samples)]
    return [slice(start, start + size) for start in np.linspace(0, samples - size, WINDOWS).astype(int).tolist()]


def _statistics(values: Array, drive: Array, parts: list[slice]) -> _Ordinary | None:
    """What is ordinary within these parts; None where too few changes of the reading lie in them."""
    moves, lengths, steps, bends, turns, products = [], [], [], [], [], np.zeros((2, 2))
    for part in parts:
        y, u = values[part], drive[part]
        edges = np.flatnonzero(y[1:] != y[:-1]) + 1
        moves.append(np.abs(np.diff(u[edges])))
        lengths.append(np.diff(edges))
        dy = y[edges] - y[edges - 1]
        both = np.isfinite(y) & np.isfinite(u)
        products += np.cov(y[both], u[both], bias=True) if both.any() else 0.0
        dy = dy[np.isfinite(dy)]
        steps.append(np.abs(dy))
        turns.append(np.sign(dy[1:]) != np.sign(dy[:-1]))
        bends.append(np.abs(np.diff(u, 2)))
    every_step, every_length = np.concatenate(steps), np.concatenate(lengths).astype(np.float64)
    if every_step.size < 2 or (every_length.size < FEWEST_RUNS and len(parts) > 1):
        return None
    alternating = float(np.mean(np.concatenate(turns)))
    return _Ordinary(
        move=_half_way(np.concatenate(moves)),
        drive_noise=float(np.nanmedian(np.concatenate(bends))) / (0.6745 * np.sqrt(6.0)),
        step=float(np.median(every_step)),
        noisy=alternating > ALTERNATING and _half_way(every_length) <= 2.0,
        together=float(products[0, 1] / spread) if (spread := np.sqrt(products[0, 0] * products[1, 1])) else 0.0,
    )


def _half_way(parts: Array) -> float:
    """The part up to which, sorted, the parts make up half of their sum."""
    ordered = np.sort(parts[np.isfinite(parts)])
    total = np.cumsum(ordered)
    return float(ordered[np.searchsorted(total, 0.5 * total[-1])]) if ordered.size else 0.0
