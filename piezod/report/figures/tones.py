"""Tones in a spectrum: narrow lines above their surroundings, in the input too or not."""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from piezod.arrays import Array

FALSE_TONES = 0.01  # expected number of lines in noise alone, in the whole spectrum
SURROUNDINGS, OWN = 12, 2  # bins on each side whose median is the background; bins on each side of a Hann line
SKIRT = 0.05  # largest excess three bins from a line, as share of its own; a Hann line has 0.001, a hump most
OVERLAP = 1.056  # variance of a mean of half-overlapping Hann windows over that of independent ones (Welch 1967)
MOST_TONES = 5  # largest tones that a page names


@dataclass(frozen=True)
class Tone:
    """A line: frequency [Hz], amplitude of the sine [unit], density at its peak, and whether the input has it."""

    frequency_Hz: float
    amplitude: float
    density: float
    in_input: bool


def find_tones(frequency_Hz: Array, density: Array, input_density: Array, windows: int) -> list[Tone]:
    """The largest tones, at most `MOST_TONES`, in descending order of amplitude.

    A line stands above the median of its surroundings by more than noise does in one of a hundred spectra.

    Parameters
    ----------
    frequency_Hz, density, input_density
        Equally spaced frequencies, and densities of the residual and of the input [unit / sqrt(Hz)], shape (F,).
    windows
        Number of half-overlapping Hann windows over which the densities are averaged.
    """
    if density.size <= 2 * SURROUNDINGS + 1:
        return []
    power, step_Hz = density**2, frequency_Hz[1] - frequency_Hz[0]
    background, of_input = _background(power), _background(input_density**2)
    spread = OVERLAP / (9.0 * windows)  # 2 / (9 degrees of freedom), each window has two
    quantile = NormalDist().inv_cdf(1.0 - FALSE_TONES / density.size)
    above = (1.0 + quantile * np.sqrt(spread) / (1.0 - spread)) ** 3  # over the median; Wilson and Hilferty (1931)
    tones = []
    excess = power - background
    for k in range(SURROUNDINGS, density.size - OWN - 1):
        line = slice(k - OWN, k + OWN + 1)
        if power[k] <= above * background[k] or power[line].max() > power[k]:
            continue
        if max(excess[k - OWN - 1], excess[k + OWN + 1]) > SKIRT * excess[k]:
            continue
        area = float(power[line].sum() - (2 * OWN + 1) * background[k]) * step_Hz
        peak = k - OWN + int(np.argmax(input_density[line]))
        shared = abs(peak - k) < OWN and input_density[peak] ** 2 > above * of_input[peak]
        tones.append(
            Tone(float(frequency_Hz[k]), float(np.sqrt(2.0 * max(area, 0.0))), float(density[k]), bool(shared))
        )
    return sorted(tones, key=lambda tone: -tone.amplitude)[:MOST_TONES]


def _background(power: Array) -> Array:
    """Median of the bins around each bin, without its own line, shape (F,)."""
    half = SURROUNDINGS
    padded = np.pad(power, half, mode="reflect")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)
    outside = np.abs(np.arange(-half, half + 1)) > OWN
    background: Array = np.median(around[:, outside], axis=1)
    return background
