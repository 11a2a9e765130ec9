"""Noise of a recording, from its samples without a model, because a misfit of a model may be repeatable.

`noise_of`: spread of the output between repetitions of a periodic input, else while the input rests.
`white_noise`: white part of the noise, from second differences. The median ignores corners and steps of the signal.
"""

import itertools
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.recordings.start import wipe_out_sample

SAME_INPUT = 0.3  # largest share of the output's differences that may come from differences of the input
SAME_COURSE = 0.01  # largest rms difference of the input between repetitions, as share of its range
COMPARED = 0.2  # share of a recording that must repeat: two periods suffice, without the start of the first
MOVING = 0.5  # share of the input's range that the repeated part must cover
AS_GOOD = 4.0  # the period is the shortest lag whose squared difference is below this multiple of the smallest
DIFFERENT_INPUT = 0.25  # share of the variance; only lags beyond a larger squared difference can be a period
COARSE = 1 << 18  # samples in which a period is searched; a longer recording is thinned to so many
MEDIAN_SPREAD = 1.4826  # standard deviation over the median magnitude of a normal distribution
FEWEST_BENDS = 100  # second differences that determine a noise
REST_S, FEWEST_SAMPLES, FEWEST_RESTS = 0.5, 20, 3  # duration of a rest [s], samples and rests that are needed
REST_SPREAD = 0.005  # largest spread of a measured input at rest, as share of its range: monitors reach 0.1 to 0.3 %
REST_WHITE = 1.5  # largest spread at rest over the white noise: an input that moves spreads by more
HEAVY_TAILS = 1.5  # spread over the spread of the middle half if single jumps dominate it; 1.38 for Laplace's law


@dataclass(frozen=True)
class Noise:
    """Noise of an output: standard deviation [output unit] and its origin."""

    rms: float
    seen_in: Literal["repeats", "rests"]


def noise_of(u: Array, y: Array, counts: NDArray[np.bool_], dt_s: float) -> Noise | None:
    """Noise of a recording; None if the input neither repeats nor rests.

    Parameters
    ----------
    u, y, counts
        Input, output, and mask of the samples that count, shape (N,).
    """
    repeats = _in_repeats(u, y, counts)
    if repeats is not None:
        return Noise(repeats, "repeats")
    found = rests(u, counts, dt_s)
    spreads = [float(np.std(y[rest], ddof=1)) for rest in found]
    return None if len(found) < FEWEST_RESTS else Noise(float(np.sqrt(np.mean(np.square(spreads)))), "rests")


def rests(u: Array, counts: NDArray[np.bool_], dt_s: float, rest_s: float = REST_S) -> list[slice]:
    """Stretches of `rest_s` in which the input rests, up to its own noise if it is measured; parameters as above."""
    size = max(round(rest_s / dt_s), FEWEST_SAMPLES)
    starts = np.flatnonzero(np.concatenate(([True], np.diff(u) != 0.0, [True])))
    exact = [
        slice(first + k, first + k + size)
        for first, end in itertools.pairwise(starts.tolist())
        for k in range(0, end - first - size + 1, size)
    ]
    measured = [slice(k, k + size) for k in range(0, u.size - size + 1, size)] if not exact else []
    most = REST_SPREAD * float(np.ptp(u))
    found = exact + [part for part in measured if float(np.std(u[part])) <= most and _is_white(u[part])]
    return [part for part in found if counts[part].all()]


def noise_of_input(u: Array, counts: NDArray[np.bool_], dt_s: float) -> float | None:
    """Standard deviation of a measured input at rest, 0 for an exact one; None if it never rests."""
    found = rests(u, counts, dt_s)
    return float(np.sqrt(np.mean([np.var(u[rest]) for rest in found]))) if found else None


def _is_white(values: Array) -> bool:
    return float(np.std(values)) <= REST_WHITE * white_noise(np.abs(np.diff(values, 2)))


def white_noise(bends: Array) -> float:
    """Standard deviation of white noise; 0 without a finite difference. A second difference has 6 times its variance.

    `bends`: magnitudes of second differences, shape (N,), nan where unknown.
    """
    bends = bends[np.isfinite(bends)]
    return MEDIAN_SPREAD * float(np.median(bends)) / float(np.sqrt(6.0)) if bends.size else 0.0


def white_noise_of(u: Array, y: Array, counts: NDArray[np.bool_]) -> float:
    """White noise of an output where its input curves least, above 0; parameters as for `noise_of`."""
    curvature, drive = np.diff(y, 2), np.abs(np.diff(u, 2))
    usable = counts[2:] & counts[1:-1] & counts[:-2]
    span = float(np.ptp(y[counts]))
    if np.count_nonzero(usable) < FEWEST_BENDS:
        return max(1e-4 * span, 1e-12)
    quiet = usable & (drive <= np.percentile(drive[usable], 50))
    return max(white_noise(np.abs(curvature[quiet])), 2e-5 * span, 1e-12)


def _in_repeats(u: Array, y: Array, counts: NDArray[np.bool_]) -> float | None:
    """Noise from the difference between each sample and the sample one period earlier, after the start.

    If jumps of the output do not repeat, the middle half of the differences decides: a jump is not noise.
    """
    lag = _period(u)
    if lag is None:
        return None
    first = min(wipe_out_sample(u), lag // 2)
    both = counts[first + lag :] & counts[first:-lag]
    moved, changed = ((values[first + lag :] - values[first:-lag])[both] for values in (u, y))
    repeated = u[first + lag :][both]
    if changed.size < max(FEWEST_SAMPLES, 0.5 * COMPARED * u.size) or np.ptp(repeated) < MOVING * np.ptp(u):
        return None
    span, other = float(np.ptp(u)), float(np.sqrt(np.mean(moved**2)))
    changed = changed - changed.mean()
    if other > min(SAME_COURSE, SAME_INPUT * float(np.std(changed)) / float(np.ptp(y[counts]))) * span:
        return None
    spread, middle = float(np.std(changed)), MEDIAN_SPREAD * float(np.median(np.abs(changed - np.median(changed))))
    return (middle if 0.0 < HEAVY_TAILS * middle < spread else spread) / float(np.sqrt(2.0))


def _period(u: Array) -> int | None:
    """Shortest lag after which the input repeats [samples]; None: the input hardly changes."""
    step = -(-u.size // COARSE)
    differences = _squared_differences(u[::step])
    away = np.flatnonzero(differences > DIFFERENT_INPUT * np.var(u))
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
    """Mean square of u[k + lag] - u[k] for lags from 0 to the longest with enough samples, shape (lags,)."""
    u = u - u.mean()
    size = u.size
    spectrum = np.fft.rfft(u, 2 * size)
    products = np.fft.irfft(spectrum * spectrum.conj())[:size]
    power = np.concatenate(([0.0], np.cumsum(u**2)))
    lags = np.arange(max(int((1.0 - COMPARED) * size), 1))
    result: Array = (power[size - lags] + power[size] - power[lags] - 2.0 * products[lags]) / (size - lags)
    return np.maximum(result, 0.0)
