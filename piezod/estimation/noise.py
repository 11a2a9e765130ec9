"""Noise of a recording, from its samples alone: a misfit of a model that repeats is no noise.

The spread of the output where the input and its past come again, else where the input rests.
"""

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOP = 0.02  # of the input's range, below its maximum, within which a peak is a peak of every period
STEADY = 0.005  # of a period, by which periods may differ
SAME_INPUT = 0.3  # of the differences of the output, that differences of the input may make up
FEWEST_PERIODS = 3  # the first one tells what came before
REST_S, FEWEST_SAMPLES, FEWEST_RESTS = 0.5, 20, 3


@dataclass(frozen=True)
class Noise:
    """Noise of an output.

    Parameters
    ----------
    rms
        Standard deviation [output unit].
    seen_in
        Where it was seen.
    """

    rms: float
    seen_in: Literal["repeats", "rests"]


def noise_of(u: Array, y: Array, counts: NDArray[np.bool_], dt_s: float) -> Noise | None:
    """Noise of a recording; None where the input neither repeats nor rests.

    Parameters
    ----------
    u, y
        Input and output, shape (N,).
    counts
        Samples that count, shape (N,).
    dt_s
        Sample period [s].
    """
    repeats = _in_repeats(u, y, counts)
    if repeats is not None:
        return Noise(repeats, "repeats")
    rests = _in_rests(u, y, counts, max(round(REST_S / dt_s), FEWEST_SAMPLES))
    return None if len(rests) < FEWEST_RESTS else Noise(float(np.sqrt(np.mean(np.square(rests)))), "rests")


def _in_repeats(u: Array, y: Array, counts: NDArray[np.bool_]) -> float | None:
    """From the differences of each sample to the one a period before, without the first period."""
    span = float(np.ptp(u))
    top = np.concatenate(([False], u > u.max() - TOP * span, [False]))
    edges = np.flatnonzero(np.diff(top.astype(np.int8)))
    peaks = 0.5 * (edges[::2] + edges[1::2] - 1)
    if peaks.size < FEWEST_PERIODS:
        return None
    period = float(peaks[-1] - peaks[0]) / (peaks.size - 1)
    if np.abs(np.diff(peaks) - period).max() > max(STEADY * period, 1.0):
        return None
    lag, first = round(period), int(peaks[0])
    both = counts[first + lag :] & counts[first:-lag]
    moved, changed = ((one[first + lag :] - one[first:-lag])[both] for one in (u, y))
    if changed.size < FEWEST_SAMPLES:
        return None
    gain = float(np.ptp(y[counts])) / span
    changed = changed - changed.mean()
    if gain * float(np.std(moved)) > SAME_INPUT * float(np.std(changed)):
        return None
    return float(np.std(changed) / np.sqrt(2.0))


def _in_rests(u: Array, y: Array, counts: NDArray[np.bool_], size: int) -> list[float]:
    """Standard deviation in every stretch in which the input rests."""
    moves = np.concatenate(([True], np.diff(u) != 0.0, [True]))
    starts = np.flatnonzero(moves)
    return [
        float(np.std(y[first + k : first + k + size], ddof=1))
        for first, end in itertools.pairwise(starts)
        for k in range(0, int(end - first) - size + 1, size)
        if counts[first + k : first + k + size].all()
    ]
