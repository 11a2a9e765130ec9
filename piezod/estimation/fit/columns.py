"""From samples to Gram matrices: the columns of the identification problem, accumulated chunk by chunk.

A superposition is written in slopes instead of weights: s_i = w_0 + ... + w_i is the slope of the loading curve between
the thresholds i and i+1.
Its column is the part of the input between both thresholds:

    H(u) = sum_i s_i (z_i - z_{i+1}),   S'(y) = sum_j s'_j (S_j(y) - S_{j+1}(y)),   the last columns: z_n, S_m

The operator does not change. But the conditions "every partial sum at least eps" become bounds, and the columns are
nearly orthogonal: for 7 to 30 plays their condition number is 10 to 35, against 100 to 5600 for the columns of the
weights. A recording of any length passes through once; only matrices as large as the number of slopes stay in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.operators.dead_zone import dead_zone_columns
from piezod.operators.play import play_states_run

CHUNK = 16_384  # samples; a chunk's columns stay in the cache of a small machine


@dataclass(frozen=True)
class Structure:
    """Thresholds of the operators that are identified."""

    play_thresholds: Array  # r_i [input unit], shape (n + 1,), from 0
    zone_thresholds: Array  # r'_j [output unit above `origin`], shape (m + 1,) or (2m + 1,), with a 0
    origin: float  # output where the dead zones start [output unit]
    u_max: float  # input where the loading curve's height is fixed to the input itself (3.17)
    zone_scale: float  # input range over output range [input unit per output unit]

    @property
    def plays(self) -> int:
        """Number of plays, with the linear part."""
        return int(self.play_thresholds.size)

    @property
    def zones(self) -> int:
        """Number of dead zones on the side with more of them, without the linear part."""
        centre = int(np.flatnonzero(self.zone_thresholds == 0.0)[0])
        return max(centre, int(self.zone_thresholds.size) - 1 - centre)

    @property
    def columns(self) -> int:
        """Number of columns: plays, a constant, dead zones."""
        return int(self.play_thresholds.size + 1 + self.zone_thresholds.size)


def weights_of(slopes: Array) -> Array:
    """Differences of the slopes."""
    return np.diff(slopes, prepend=0.0)


def zone_slopes_of(thresholds: Array, weights: Array) -> Array:
    """Partial sums of the weights from the zero threshold outwards, in the order of the thresholds."""
    centre = int(np.flatnonzero(thresholds == 0.0)[0])
    return np.concatenate((np.cumsum(weights[centre::-1])[:0:-1], np.cumsum(weights[centre:])))


def zone_weights_of(thresholds: Array, slopes: Array) -> Array:
    """Weights from their outward partial sums; inverse of `zone_slopes_of`."""
    centre = int(np.flatnonzero(thresholds == 0.0)[0])
    lower = np.diff(slopes[centre::-1])[::-1]
    return np.concatenate((lower, [slopes[centre]], np.diff(slopes[centre:])))


def zone_segments(thresholds: Array, x: Array) -> Array:
    """Part of each sample of `x` that lies between a threshold and the next one outwards, shape (N, count)."""
    centre = int(np.flatnonzero(thresholds == 0.0)[0])
    zones = np.empty((x.size, thresholds.size))
    dead_zone_columns(thresholds, x, zones)
    segments = zones.copy()
    segments[:, centre:-1] -= zones[:, centre + 1 :]
    segments[:, 1:centre] -= zones[:, : centre - 1] if centre > 1 else 0.0
    if centre > 0:
        segments[:, centre] -= zones[:, centre - 1]
    return segments


class PlaySegments:
    """Play columns of successive samples; the states carry over.

    Parameters
    ----------
    thresholds
        r_i, shape (n + 1,); de-energised before the first sample.
    """

    def __init__(self, thresholds: Array) -> None:
        self._count = int(thresholds.size)
        self._packed = np.concatenate((thresholds, np.zeros(2 * thresholds.size)))

    def run(self, u: Array) -> Array:
        """Columns z_i - z_{i+1} over the next samples, shape (N, n + 1)."""
        states = np.empty((u.size, self._count))
        play_states_run(self._packed, 0, self._count, u, states)
        states[:, :-1] -= states[:, 1:]
        return states


@dataclass(frozen=True)
class Samples:
    """A stretch of a recording with a mask of the samples that count.

    Parameters
    ----------
    u, y
        Input and output, shape (N,).
    counts
        Mask of the outputs that are used, shape (N,); the plays always follow every sample.
    clock
        Linear time with 0 at the end of the fitted part, shape (N,), for a fitted drift of the output. None: no drift;
        on a record from rest it could not be distinguished from the first rise of wide plays.
    path
        Inputs from the de-energised state up to the first sample [input unit].
    """

    u: Array
    y: Array
    counts: NDArray[np.bool_]
    clock: Array | None = None
    path: tuple[float, ...] = ()


def clocks_of(recordings: Sequence[Samples]) -> int:
    """Number of recordings with a fitted drift."""
    return sum(samples.clock is not None for samples in recordings)
