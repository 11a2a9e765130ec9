"""Noise of a recording, from its samples alone: a misfit of a model that repeats is no noise.

The spread of the output where the input and its past come again, else where the input rests.
"""

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.estimation.initial_state import settled_from

Array = NDArray[np.float64]

SAME_INPUT = 0.3  # of the differences of the output, that differences of the input may make up
SAME_COURSE = 0.01  # of the input's range, root mean square: beyond it the input is another one, whatever the output
COMPARED = 0.2  # of a recording, that must come again: two periods are enough, without the start of the first one
MOVING = 0.5  # of the input's range, that what comes again must cover
AS_GOOD = 4.0  # times the smallest squared difference of the input: of the lags below it the shortest is the period
RAN_APART = 0.25  # of the input's mean square: beyond it the input is another, and what comes later may be a repeat
COARSE = 1 << 18  # samples of the input in which a period is looked for; of a longer recording every so many
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
    """From the differences of each sample to the one a period before.

    They count from where the start is forgotten, from half a period on at the latest.
    """
    lag = _period(u)
    if lag is None:
        return None
    first = min(settled_from(u), lag // 2)
    both = counts[first + lag :] & counts[first:-lag]
    moved, changed = ((one[first + lag :] - one[first:-lag])[both] for one in (u, y))
    again = u[first + lag :][both]
    if changed.size < max(FEWEST_SAMPLES, 0.5 * COMPARED * u.size) or np.ptp(again) < MOVING * np.ptp(u):
        return None
    span, other = float(np.ptp(u)), float(np.sqrt(np.mean(moved**2)))
    changed = changed - changed.mean()
    if other > min(SAME_COURSE, SAME_INPUT * float(np.std(changed)) / float(np.ptp(y[counts]))) * span:
        return None
    return float(np.std(changed) / np.sqrt(2.0))


def _period(u: Array) -> int | None:
    """Shortest lag after which the input comes again best [samples]; None: it never runs away from where it was."""
    step = -(-u.size // COARSE)
    differences = _squared_differences(u[::step])
    away = np.flatnonzero(differences > RAN_APART * np.var(u))
    if not away.size or away[0] + 1 >= differences.size:
        return None
    first = int(away[0])
    least = AS_GOOD * float(differences[first:].min()) + np.finfo(np.float64).eps * float(np.var(u))
    coarse = first + int(np.argmax(differences[first:] <= least))
    while coarse + 1 < differences.size and differences[coarse + 1] < differences[coarse]:
        coarse += 1
    near = range(max((coarse - 1) * step, 1) + 1, min((coarse + 1) * step, u.size - 1)) if step > 1 else (coarse,)
    return min(near, key=lambda lag: float(np.mean(np.square(u[lag:] - u[:-lag]))))


def _squared_differences(u: Array) -> Array:
    """Mean square of u[k + lag] - u[k] for each lag that leaves enough to compare, shape (lags,), from lag 0."""
    u = u - u.mean()
    size = u.size
    spectrum = np.fft.rfft(u, 2 * size)
    products = np.fft.irfft(spectrum * spectrum.conj())[:size]
    power = np.concatenate(([0.0], np.cumsum(u**2)))
    lags = np.arange(max(int((1.0 - COMPARED) * size), 1))
    found: Array = (power[size - lags] + power[size] - power[lags] - 2.0 * products[lags]) / (size - lags)
    return np.maximum(found, 0.0)


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
