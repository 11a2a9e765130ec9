"""Long curves for a screen: every stretch by its smallest and its largest value, and the range that shows them."""

import numpy as np
from bokeh.models import Range1d
from numpy.typing import NDArray

Array = NDArray[np.float64]

USUAL, MARGIN = 0.998, 0.5  # part of the residuals that an axis shows at least, and how much more room it has


def envelope(values: Array, points: int) -> Array:
    """Smallest and largest value of equal stretches, in the order in which they come.

    Parameters
    ----------
    values
        Shape (N,); values that are not finite are left out, a stretch without any other is not a number.
    points
        How many are wanted; a curve with no more is given back as it is.

    Returns
    -------
    ndarray
        Shape (M,), M at most `points` or N.
    """
    if values.size <= points:
        return values
    table = _stretches(values, points)
    known = np.isfinite(table)
    least = np.where(known, table, np.inf).argmin(axis=1)
    most = np.where(known, table, -np.inf).argmax(axis=1)
    rows = np.arange(table.shape[0])
    both = np.stack((np.minimum(least, most), np.maximum(least, most)), axis=1)
    result: Array = table[rows[:, None], both].ravel()
    result[np.repeat(~known.any(axis=1), 2)] = np.nan
    return result


def envelope_times(time_s: Array, points: int) -> Array:
    """Times that belong to `envelope`: where every stretch and its second half begin, shape (M,) [s]."""
    if time_s.size <= points:
        return time_s
    table = _stretches(time_s, points)
    result: Array = table[:, [0, table.shape[1] // 2]].ravel()
    return result


def extremes(values: Array, points: int) -> NDArray[np.int64]:
    """Indices of the smallest and the largest value of equal stretches, rising, shape (M,)."""
    if values.size <= points:
        return np.arange(values.size)
    table = _stretches(np.where(np.isfinite(values), values, 0.0), points)
    rows = np.arange(table.shape[0]) * table.shape[1]
    both = np.concatenate((rows + table.argmin(axis=1), rows + table.argmax(axis=1)))
    result: NDArray[np.int64] = np.unique(np.minimum(both, values.size - 1))
    return result


def usual_range(*residuals: Array) -> Range1d:
    """What nearly all residuals lie in, with a margin: a start that takes some samples does not flatten the rest."""
    left = np.concatenate(residuals)
    left = left[np.isfinite(left)]
    low, high = (float(end) for end in np.quantile(left, (1.0 - USUAL, USUAL)))
    margin = MARGIN * max(high - low, 1e-12)
    least, most = float(left.min()) - 0.1 * margin, float(left.max()) + 0.1 * margin
    return Range1d(start=max(low - margin, least), end=min(high + margin, most))


def _stretches(values: Array, points: int) -> Array:
    """Values row by row, shape (stretches, length); the last value stands for those that the last row lacks."""
    length = -(-values.size // max(points // 2, 1))
    rows = -(-values.size // length)
    padded = np.concatenate((values, np.full(rows * length - values.size, values[-1])))
    return padded.reshape(rows, length)
