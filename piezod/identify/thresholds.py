"""Where plays and dead zones begin (3.25-3.27), denser where a stack's memory changes most."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def play_thresholds(count: int, reach: float, *, growth: float = 1.0) -> Array:
    """0 = r_0 < ... < r_n < reach: r_i = reach (i / (n + 1))^growth.

    Parameters
    ----------
    count
        n, the plays besides the linear part.
    reach
        Largest threshold that still moves [V]: half the range on a unipolar drive, because a play wider than that is
        frozen after the first peak (THEORY 1.3).
    growth
        1: equally spaced (3.25); above 1: finer near zero.
    """
    return reach * (np.arange(count + 1) / (count + 1)) ** growth


def dead_zone_thresholds(count: int, low: float, high: float) -> Array:
    """Thresholds of the inverse dead zones [output unit]: i/(m+1) of the largest output (3.26).

    Where `low` is below zero by more than a tenth of `high`, as many on the other side (3.27): the two-sided variant.

    Parameters
    ----------
    count
        m, the dead zones beside the linear part, on each side.
    low, high
        Range of the output measured from the point where the dead zones start.
    """
    upper = high * np.arange(count + 1) / (count + 1)
    if low >= -0.1 * high:
        return upper
    return np.concatenate((low * np.arange(count, 0, -1) / (count + 1), upper))
