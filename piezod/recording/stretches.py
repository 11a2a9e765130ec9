"""Searches in the arrays of a recording: repeated values, gaps in time, sample periods; and linear interpolation."""

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array

Stretch = tuple[int, int]  # consecutive samples: (number of the first sample, number after the last sample)
BLOCK = 2**20  # samples that are processed together, so that temporary arrays stay small for a long recording
GAP_PERIODS = 5  # length of a pause above which it is a gap [sample periods]; a gap is never interpolated


def long_runs(values: Array, at_least: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """First samples of long runs of identical values, and the samples after their ends.

    Parameters
    ----------
    values
        Shape (N,); nan is equal to no value.
    at_least
        Shortest run [samples], at least 1.

    Returns
    -------
    starts, stops
        Each shape (runs,).
    """
    starts, stops = [np.empty(0, np.intp)], [np.empty(0, np.intp)]
    begun = 0
    for block in range(0, values.size, BLOCK):
        part = values[block : block + BLOCK + 1]
        bounds = np.concatenate([[begun], block + 1 + np.flatnonzero(part[1:] != part[:-1])]).astype(np.intp)
        long = np.diff(bounds) >= at_least
        starts.append(bounds[:-1][long])
        stops.append(bounds[1:][long])
        begun = int(bounds[-1])
    last = values.size - begun >= at_least
    starts.append(np.full(int(last), begun, np.intp))
    stops.append(np.full(int(last), values.size, np.intp))
    return np.concatenate(starts), np.concatenate(stops)


def median_period(time_s: Array) -> float:
    """Median sample period of at least two samples [s]; for a long recording, of about a million of its periods.

    Parameters
    ----------
    time_s
        Times [s], shape (N,), strictly increasing, N at least 2.
    """
    every = max(1, time_s.size // BLOCK)
    return float(np.median(time_s[1::every] - time_s[:-1:every]))


def extreme_periods(time_s: Array) -> tuple[float, float]:
    """Shortest and longest sample period of at least two samples [s].

    Parameters
    ----------
    time_s
        Times [s], shape (N,), strictly increasing, N at least 2.
    """
    shortest_s, longest_s = np.inf, 0.0
    for at in range(0, time_s.size - 1, BLOCK):
        periods = np.diff(time_s[at : at + BLOCK + 1])
        shortest_s, longest_s = min(shortest_s, float(periods.min())), max(longest_s, float(periods.max()))
    return shortest_s, longest_s


def gaps(time_s: Array) -> list[Stretch]:
    """(sample before, sample after) each pause of more than `GAP_PERIODS` median sample periods.

    Parameters
    ----------
    time_s
        Times [s], shape (N,), strictly increasing.
    """
    if time_s.size < 2:
        return []
    longest_s = GAP_PERIODS * median_period(time_s)
    starts = range(0, time_s.size - 1, BLOCK)
    places = [at + np.flatnonzero(np.diff(time_s[at : at + BLOCK + 1]) > longest_s) for at in starts]
    before = np.concatenate(places)
    return pairs(before, before + 1)


def interpolated(time_s: Array, values: Array, at_s: Array, longest_s: float) -> Array:
    """Linear interpolation between the samples of a channel that are present.

    Parameters
    ----------
    time_s, values
        Times [s] and values of the samples, each shape (N,); nan: missing sample.
    at_s
        Times of the result, shape (M,) [s].
    longest_s
        Longest pause between two present samples over which values are interpolated [s].

    Returns
    -------
    Array
        Shape (M,); nan within longer pauses and outside of the present samples.
    """
    present = ~np.isnan(values)
    time_s, values = time_s[present], values[present]
    if time_s.size == 0:
        return np.full(at_s.shape, np.nan)
    result = np.interp(at_s, time_s, values, left=np.nan, right=np.nan)
    after = np.searchsorted(time_s, at_s)
    inside = (after > 0) & (after < time_s.size)
    right = np.where(inside, after, 0)
    interpolates = inside & (time_s[right] != at_s)
    result[interpolates & (time_s[right] - time_s[right - 1] > longest_s)] = np.nan
    return np.asarray(result, dtype=np.float64)


def stretches_of(mask: NDArray[np.bool_]) -> list[Stretch]:
    """Stretches (first, end) in which a mask is true.

    Parameters
    ----------
    mask
        Shape (N,).
    """
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    return pairs(edges[::2], edges[1::2])


def pairs(starts: NDArray[np.intp], stops: NDArray[np.intp]) -> list[Stretch]:
    """List of (start, stop) from their arrays, each shape (n,).

    Parameters
    ----------
    starts, stops
        Sample numbers, each of shape (n,).
    """
    return list(zip(starts.tolist(), stops.tolist(), strict=True))
