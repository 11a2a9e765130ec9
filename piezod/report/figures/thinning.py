"""Long curves thinned for a screen, and the axis range of residuals.

A curve is cut into segments of equal length. Each segment is drawn by its smallest and its largest value.
"""

import numpy as np
from bokeh.models import Range1d
from numpy.typing import NDArray

from piezod.arrays import Array

SHOWN = 0.998  # quantile of the residuals that an axis shows at least
GAP = 3.0  # median steps; a shorter gap cannot be seen
MARGIN = 0.5  # room beyond that quantile, relative to the shown range


def envelope(values: Array, points: int) -> Array:
    """Smallest and largest value of each segment, in the order in which they occur.

    Parameters
    ----------
    values
        Curve, shape (N,). Values that are not finite are ignored; a segment without finite values becomes nan.
    points
        Number of points to return, about. A curve with at most this many points is returned unchanged.

    Returns
    -------
    ndarray
        Shape (M,), M at most `points` or N.
    """
    if values.size <= points:
        return values
    table = _segments(values, points)
    known = np.isfinite(table)
    least = np.where(known, table, np.inf).argmin(axis=1)
    most = np.where(known, table, -np.inf).argmax(axis=1)
    rows = np.arange(table.shape[0])
    both = np.stack((np.minimum(least, most), np.maximum(least, most)), axis=1)
    result: Array = table[rows[:, None], both].ravel()
    result[np.repeat(~known.any(axis=1), 2)] = np.nan
    return result


def envelope_times(time_s: Array, points: int) -> Array:
    """Times of the points of `envelope`: the start and the middle of each segment, shape (M,) [s].

    Parameters
    ----------
    time_s
        Times of the curve, shape (N,) [s].
    points
        As in `envelope`.
    """
    if time_s.size <= points:
        return time_s
    table = _segments(time_s, points)
    result: Array = table[:, [0, table.shape[1] // 2]].ravel()
    return result


def broken_at_gaps(time_s: Array, values: Array) -> tuple[Array, Array]:
    """Curve with a nan where times are missing, so that no line is drawn there; both shape (M,), M at least N.

    Parameters
    ----------
    time_s, values
        Curve, shape (N,) [s] and any unit.
    """
    steps = np.diff(time_s)
    gaps = np.flatnonzero(steps > GAP * np.median(steps)) + 1 if steps.size else np.empty(0, dtype=np.int64)
    return np.insert(time_s, gaps, time_s[gaps - 1]), np.insert(values, gaps, np.nan)


def extremes(values: Array, points: int) -> NDArray[np.int64]:
    """Indices of the smallest and the largest value of each segment, ascending, shape (M,).

    Parameters
    ----------
    values
        Curve, shape (N,). Values that are not finite count as 0.
    points
        As in `envelope`.
    """
    if values.size <= points:
        return np.arange(values.size)
    table = _segments(np.where(np.isfinite(values), values, 0.0), points)
    rows = np.arange(table.shape[0]) * table.shape[1]
    both = np.concatenate((rows + table.argmin(axis=1), rows + table.argmax(axis=1)))
    result: NDArray[np.int64] = np.unique(np.minimum(both, values.size - 1))
    return result


def robust_range(*residuals: Array) -> Range1d:
    """Axis range that contains nearly all residuals, with a margin, so that a few outliers do not flatten the curve.

    Parameters
    ----------
    residuals
        Arrays of any length, in the unit of the axis. Values that are not finite are ignored.
    """
    values = np.concatenate(residuals)
    values = values[np.isfinite(values)]
    low, high = (float(end) for end in np.quantile(values, (1.0 - SHOWN, SHOWN)))
    margin = MARGIN * max(high - low, 1e-12)
    least, most = float(values.min()) - 0.1 * margin, float(values.max()) + 0.1 * margin
    return Range1d(start=max(low - margin, least), end=min(high + margin, most))


def _segments(values: Array, points: int) -> Array:
    """Values with one segment a row, shape (segments, length). Copies of the last value fill the last row."""
    length = -(-values.size // max(points // 2, 1))
    rows = -(-values.size // length)
    padded = np.concatenate((values, np.full(rows * length - values.size, values[-1])))
    return padded.reshape(rows, length)
