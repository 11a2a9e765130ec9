"""Where plays and dead zones begin (3.25-3.27), denser where a stack's memory changes most."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINER_NEAR_ZERO = 1.5  # exponent of the play thresholds; 1 would be (3.25)
TWO_SIDED_FROM = 0.1  # share of the output's range below its start from which dead zones are laid on both sides


def play_thresholds(count: int, reach: float, *, growth: float = FINER_NEAR_ZERO) -> Array:
    """0 = r_0 < ... < r_n < reach: r_i = reach (i / (n + 1))^growth.

    Parameters
    ----------
    count
        n, the plays besides the linear part.
    reach
        Where the thresholds end [input unit].
    growth
        1: equally spaced (3.25); above 1: finer near zero.
    """
    return reach * (np.arange(count + 1) / (count + 1)) ** growth


def play_reach(u: Array) -> float:
    """Largest threshold whose play the input tells anything about [input unit].

    A play follows after its input has moved by twice its threshold. Where the record starts de-energised its first rise
    shows the wider ones too, up to the peak; without that they stand still for ever (THEORY 1.3).
    """
    swing = float(np.ptp(u))
    starts_at_rest = abs(u[0]) <= 0.02 * swing
    return float(np.abs(u).max()) if starts_at_rest else 0.5 * swing


def dead_zone_thresholds(count: int, low: float, high: float) -> Array:
    """Thresholds of the inverse dead zones [output unit]: i/(m+1) of the largest output (3.26).

    Where `low` lies below zero by more than a tenth of `high`, as many on the other side (3.27): the two-sided variant.

    Parameters
    ----------
    count
        m, the dead zones beside the linear part, on each side.
    low, high
        Range of the output measured from the point where the dead zones start.
    """
    upper = high * np.arange(count + 1) / (count + 1)
    if low >= -TWO_SIDED_FROM * high:
        return upper
    return np.concatenate((low * np.arange(count, 0, -1) / (count + 1), upper))
