"""Thresholds of plays and dead zones (3.25-3.27); play thresholds are denser near zero."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array

FINER_NEAR_ZERO = 1.5  # exponent of the play thresholds; 1 would be (3.25)
INSIDE = 0.995  # largest threshold as share of the limit, where a play would move in a single sample only
TWO_SIDED_FROM = 0.1  # dead zones lie on both sides if the output goes below its start by this share of its range


@dataclass(frozen=True)
class Reach:
    """Range of the thresholds that an input determines."""

    end: float  # largest threshold of the dense grid [input unit]
    beyond: float | None = None  # another threshold above it, or None [input unit]


def play_thresholds(count: int, reach: float, *, beyond: float | None = None, growth: float = FINER_NEAR_ZERO) -> Array:
    """0 = r_0 < ... < r_n < reach: r_i = reach (i / (n + 1))^growth.

    Parameters
    ----------
    count
        n, the number of plays without the linear part.
    reach
        Upper limit of the thresholds [input unit].
    beyond
        Last threshold, above `reach` [input unit]; None: below `reach` like the others.
    growth
        1: equally spaced (3.25); above 1: denser near zero.
    """
    if beyond is None or count < 1:
        return reach * (np.arange(count + 1) / (count + 1)) ** growth
    return np.append(reach * (np.arange(count) / count) ** growth, beyond)


def play_reach(u: Array, path: Sequence[float], *, at_rest: bool) -> Reach:
    """Range of the play thresholds that an input determines.

    A play follows after its input has moved by twice its threshold, so half the swing is the limit. A first rise from
    the de-energised state also moves wider plays, up to the peak; otherwise they never move
    (piezod/operators/README.md, "Limits of validity"). A rise beyond an old peak determines only the summed weight of
    the wider plays, so a single threshold represents them.

    Parameters
    ----------
    u, path
        Input, shape (N,), and the inputs from the de-energised state up to its first sample [input unit].
    """
    half, peak = 0.5 * float(np.ptp(u)), float(np.abs(u).max())
    if not at_rest:
        return Reach(INSIDE * half)
    old = max((abs(level) for level in path), default=0.0)
    if old < 0.5 * peak:
        return Reach(INSIDE * peak)
    return Reach(INSIDE * half, 0.5 * (half + old) if old < INSIDE * peak else None)


def widest(reaches: Sequence[Reach]) -> Reach:
    """Union of the ranges of several recordings."""
    end = max(reach.end for reach in reaches)
    beyond = [reach.beyond for reach in reaches if reach.beyond is not None and reach.beyond > end]
    return Reach(end, max(beyond, default=None))


def dead_zone_thresholds(count: int, low: float, high: float) -> Array:
    """Thresholds of the inverse dead zones [output unit]: i/(m+1) of the largest output (3.26).

    If `low` is below zero by more than a tenth of `high`, there are as many on the other side (3.27).

    Parameters
    ----------
    count
        m, the number of dead zones on each side, without the linear part.
    low, high
        Range of the output, relative to its value where the dead zones start [output unit].
    """
    upper = high * np.arange(count + 1) / (count + 1)
    if low >= -TWO_SIDED_FROM * high:
        return upper
    return np.concatenate((low * np.arange(count, 0, -1) / (count + 1), upper))
