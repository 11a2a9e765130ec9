"""Tones, jumps and bursts that noise with the spectrum of a residual would not show."""

from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array, Mask
from piezod.diagnose.localisation import colour

SIGNIFICANT = 1e-3  # family-wise probability with which noise shows a tone, a jump or a burst
MOST_TONES, MOST_JUMPS = 6, 4
SLOWEST_CYCLES = 3  # lowest frequency of a tone [cycles per record]
JUMP_WINDOWS_S = (0.1, 0.4, 1.6)  # time on either side of a jump whose means are compared
FEWEST_WINDOWS = 60  # windows that determine the spread of the means
BURST_SAMPLES = (1, 8, 64, 512)  # lengths of a burst
COARSE = 2.0  # converter step above which rounding shapes the residual [spread of the residual]


@dataclass(frozen=True)
class Bursts:
    """Stretches with more power than noise of the residual's spectrum has."""

    energy: float  # sum of squares in them above that of the other samples
    p: float  # family-wise p-value of the strongest


def tones_Hz(values: Array, dt_s: float) -> list[float]:
    """Frequencies of narrow peaks, the highest first; noise shows a peak in one of a thousand records."""
    spectrum = colour.windowed_spectrum(values)
    over = colour.prominence(spectrum, SLOWEST_CYCLES)
    least = np.log(over.size / SIGNIFICANT)
    peaks: list[int] = []
    for peak in np.argsort(over)[::-1]:
        if over[peak] < least or len(peaks) == MOST_TONES:
            break
        if all(abs(int(peak) - other) > 3 for other in peaks):
            peaks.append(int(peak))
    bin_Hz = 1.0 / (values.size * dt_s)
    return [colour.refined_frequency_Hz(values - values.mean(), dt_s, peak * bin_Hz) for peak in peaks]


def jumps(values: Array, dt_s: float, step: float) -> list[int]:
    """Samples at which the level jumps, the most significant first.

    `step`: converter step [unit of the values]; rounding causes smaller jumps.
    """
    total = np.concatenate(([0.0], np.cumsum(values)))
    significant: list[tuple[float, int, int]] = []
    for window_s in (min(JUMP_WINDOWS_S[0], values.size * dt_s / (FEWEST_WINDOWS + 3)), *JUMP_WINDOWS_S[1:]):
        window = max(int(window_s / dt_s), 8)
        stride = max(window // 8, 1)
        at = np.arange(window, values.size - window, stride)
        if at.size * stride < FEWEST_WINDOWS * window:
            continue
        change = (total[at + window] - 2.0 * total[at] + total[at - window]) / window
        z = np.abs(change) / max(colour.spread(change), 0.35 * step, 1e-12)
        least = np.sqrt(2.0 * np.log(at.size / SIGNIFICANT))
        significant += [(float(z[k] / least), int(at[k]), window) for k in np.flatnonzero(z > least)]
    jumps_at: list[tuple[int, int]] = []
    for _, at_k, window in sorted(significant, reverse=True):
        if all(abs(at_k - other) > max(window, wide) for other, wide in jumps_at) and len(jumps_at) < MOST_JUMPS:
            jumps_at.append((at_k, window))
    return [_refined(total, at_k, window) for at_k, window in jumps_at]


def _refined(total: Array, near: int, window: int) -> int:
    """Sample near a jump at which the means before and after differ most."""
    places = np.arange(max(near - window // 2, window), min(near + window // 2, total.size - 1 - window))
    if not places.size:
        return near
    change = total[places + window] - 2.0 * total[places] + total[places - window]
    return int(places[np.argmax(np.abs(change))])


def bursts(values: Array, counts: Mask, step: float) -> Bursts:
    """Find stretches with more power than noise of the residual's spectrum has.

    `counts`: mask of the values that count, shape (N,); `step`: converter step [unit of the values].
    """
    coarse = step > COARSE * colour.spread(values)
    innovations = values if coarse else colour.innovations(values)
    unit = max(colour.spread(innovations[counts]), 0.5 * step if coarse else 0.0, 1e-12)
    known = np.concatenate(([0.0], np.cumsum(counts)))
    total = np.concatenate(([0.0], np.cumsum(np.where(counts, innovations / unit, 0.0) ** 2)))
    in_burst, smallest = np.zeros(values.size, bool), 1.0
    for samples in (length for length in BURST_SAMPLES if length <= values.size):
        edges = np.arange(0, values.size + 1, samples)
        n, power = np.diff(known[edges]), np.diff(total[edges])
        p = _tail_probability(power, n, samples, 1.0 if coarse else 0.0)
        p = np.minimum(p * np.count_nonzero(n) * len(BURST_SAMPLES), 1.0)
        smallest = min(smallest, float(p.min()))
        for k in np.flatnonzero(p < SIGNIFICANT):
            in_burst[edges[k] : edges[k + 1]] = True
    in_burst &= counts
    others = counts & ~in_burst
    mean_power = float(np.mean(values[others] ** 2)) if others.any() else 0.0
    excess = float(np.sum(values[in_burst] ** 2)) - mean_power * np.count_nonzero(in_burst)
    return Bursts(max(excess, 0.0), smallest)


def _tail_probability(power: Array, n: Array, samples: int, least: float) -> Array:
    """Probability of at least this power in n samples; cube roots of mean squares are nearly normal.

    `least`: smallest mean square that is expected.
    """
    full = n > 0.5 * samples
    width = 2.0 / (9.0 * samples)
    root = np.cbrt(power / np.maximum(n, 1.0))
    middle = float(np.median(root[full])) if full.any() else 1.0
    if samples < 8:
        middle = 1.0 - width
    middle = max(middle, least)
    deviation = max(np.sqrt(width) * max(middle, 1e-12), colour.spread(root[full]) if samples >= 8 else 0.0)
    z = np.where(full, (root - middle) / deviation, 0.0)
    if samples == 1:
        z = np.sqrt(power)
    bound: Array = np.where(z > 0.0, np.exp(-0.5 * np.maximum(z, 0.0) ** 2), 1.0)  # Chernoff's, for a normal tail
    return bound
