"""Where a channel stands still, is cut off, or is missing; where time has a gap. Arrays in, sample numbers out."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stretch = tuple[int, int]
"""First sample, and the one after the last."""

GAP_PERIODS = 5
"""A pause longer than so many sample periods is a gap: over it nothing is interpolated."""


def runs(values: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Starts and stops of runs of identical values, each shape (runs,); a nan is a run of its own."""
    edges = np.flatnonzero(values[1:] != values[:-1]) + 1
    return np.concatenate([[0], edges]), np.concatenate([edges, [values.size]])


def typical_run(values: Array) -> float:
    """Median length of the runs of identical values [samples]: 1 for a noisy reading, more for a coarse or slow one."""
    starts, stops = runs(values)
    return float(np.median(stops - starts))


def frozen(values: Array, others: Iterable[Array], at_least: int) -> list[Stretch]:
    """Runs of at least so many identical values during which one of the others changes."""
    starts, stops = _long_runs(values, at_least)
    moves = np.zeros(starts.size, dtype=bool)
    for other in others:
        present = ~np.isnan(other)
        changed = (other[1:] != other[:-1]) & present[1:] & present[:-1]
        changes = np.concatenate([[0], np.cumsum(changed)])
        moves |= changes[stops - 1] > changes[starts]
    return _pairs(starts[moves], stops[moves])


def clipped(values: Array, at_least: int) -> list[Stretch]:
    """Runs of at least so many values at the largest or the smallest of all; none in a flag, which has no others."""
    present = values[~np.isnan(values)]
    if present.size == 0 or not ((present > present.min()) & (present < present.max())).any():
        return []
    starts, stops = _long_runs(values, at_least)
    extreme = (values[starts] == present.min()) | (values[starts] == present.max())
    return _pairs(starts[extreme], stops[extreme])


def gaps(time_s: Array) -> list[Stretch]:
    """Pairs of neighbouring samples farther apart than five median periods."""
    if time_s.size < 2:
        return []
    periods = np.diff(time_s)
    before = np.flatnonzero(periods > GAP_PERIODS * np.median(periods))
    return _pairs(before, before + 1)


def interpolated(time_s: Array, values: Array, at_s: Array, longest_s: float) -> Array:
    """Linear interpolation between samples that are there; nan where they are farther apart than `longest_s` [s]."""
    present = ~np.isnan(values)
    time_s, values = time_s[present], values[present]
    if time_s.size == 0:
        return np.full(at_s.shape, np.nan)
    result = np.interp(at_s, time_s, values, left=np.nan, right=np.nan)
    after = np.searchsorted(time_s, at_s)
    inside = (after > 0) & (after < time_s.size)
    right = np.where(inside, after, 0)
    between = inside & (time_s[right] != at_s)
    result[between & (time_s[right] - time_s[right - 1] > longest_s)] = np.nan
    return np.asarray(result, dtype=np.float64)


def _long_runs(values: Array, at_least: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    starts, stops = runs(values)
    long = (stops - starts >= at_least) & ~np.isnan(values[starts])
    return starts[long], stops[long]


def _pairs(starts: NDArray[np.intp], stops: NDArray[np.intp]) -> list[Stretch]:
    return list(zip(starts.tolist(), stops.tolist(), strict=True))
