"""Where plays and dead zones begin (3.25-3.27), denser where a stack's memory changes most."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINER_NEAR_ZERO = 1.5  # exponent of the play thresholds; 1 would be (3.25)
INSIDE = 0.995  # share of the outermost place: the play there would move in a single sample
TWO_SIDED_FROM = 0.1  # share of the output's range below its start from which dead zones are laid on both sides


@dataclass(frozen=True)
class Reach:
    """Which plays an input tells anything about.

    Parameters
    ----------
    end
        Largest threshold of the dense grid [input unit].
    beyond
        One more threshold above it, or None [input unit].
    """

    end: float
    beyond: float | None = None


def play_thresholds(count: int, reach: float, *, beyond: float | None = None, growth: float = FINER_NEAR_ZERO) -> Array:
    """0 = r_0 < ... < r_n < reach: r_i = reach (i / (n + 1))^growth.

    Parameters
    ----------
    count
        n, the plays besides the linear part.
    reach
        Where the thresholds end [input unit].
    beyond
        The last threshold instead, where one above `reach` is wanted [input unit].
    growth
        1: equally spaced (3.25); above 1: finer near zero.
    """
    if beyond is None or count < 1:
        return reach * (np.arange(count + 1) / (count + 1)) ** growth
    return np.append(reach * (np.arange(count) / count) ** growth, beyond)


def play_reach(u: Array, path: Sequence[float], *, at_rest: bool) -> Reach:
    """Which plays this input tells anything about, from the start that it had.

    A play follows after its input has moved by twice its threshold, so half the swing is the end. A first rise from the
    de-energised state shows the wider ones too, up to the peak; without one they stand still for ever
    (piezod/operators/README.md, "Limits of validity").
    Of a rise that passes an old peak the part above shows the sum of the wider ones: one threshold stands for all.

    Parameters
    ----------
    u
        Input, shape (N,).
    path
        Inputs before its first sample since the de-energised state.
    at_rest
        Whether the record starts at zero.
    """
    half, peak = 0.5 * float(np.ptp(u)), float(np.abs(u).max())
    if not at_rest:
        return Reach(INSIDE * half)
    old = max((abs(level) for level in path), default=0.0)
    if old < 0.5 * peak:
        return Reach(INSIDE * peak)
    return Reach(INSIDE * half, 0.5 * (half + old) if old < INSIDE * peak else None)


def widest(reaches: Sequence[Reach]) -> Reach:
    """What several recordings tell together."""
    end = max(reach.end for reach in reaches)
    beyond = [reach.beyond for reach in reaches if reach.beyond is not None and reach.beyond > end]
    return Reach(end, max(beyond, default=None))


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
