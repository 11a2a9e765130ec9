"""The spectrum of a residual, and its map over time and frequency, against white noise as large as the floor."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS, ROWS = 120, 96
SHORTEST, LONGEST = 64, 4096  # samples of a window


@dataclass(frozen=True)
class Map:
    """Power over time and frequency.

    Parameters
    ----------
    time_s
        Edges of the columns, shape (C + 1,), since the first sample.
    frequency_Hz
        Edges of the rows, shape (R + 1,), in equal ratios.
    level_dB
        Over the noise floor, shape (R, C).
    """

    time_s: Array
    frequency_Hz: Array
    level_dB: Array


def spectrum(residual: Array, dt_s: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and amplitude density [unit / sqrt(Hz)], each shape (F,); Welch's mean of Hann windows."""
    size = min(max(residual.size // 8, SHORTEST), LONGEST, residual.size)
    starts = np.arange(0, residual.size - size + 1, max(size // 2, 1))
    power = _windowed_power(residual, dt_s, size, starts).mean(axis=0)
    frequency_Hz: Array = np.fft.rfftfreq(size, dt_s)[1:].astype(np.float64)
    return frequency_Hz, np.sqrt(power[1:])


def time_frequency(residual: Array, dt_s: float, floor: float) -> Map:
    """Where in time and frequency a residual is more than its noise.

    Parameters
    ----------
    residual
        Shape (N,).
    dt_s
        Spacing of the samples [s].
    floor
        Standard deviation of the noise, in the residual's unit: 0 dB is white noise as large.
    """
    size = int(np.clip(residual.size // (COLUMNS // 3), SHORTEST, LONGEST))
    size = min(size, residual.size)
    starts = np.unique(np.linspace(0, residual.size - size, COLUMNS).astype(int))
    power = _windowed_power(residual, dt_s, size, starts)
    frequency_Hz = np.fft.rfftfreq(size, dt_s).astype(np.float64)
    edges_Hz = np.geomspace(frequency_Hz[1], frequency_Hz[-1], ROWS + 1)
    rows = np.stack([_row(power, frequency_Hz, a, b) for a, b in itertools.pairwise(edges_Hz)])
    reference = 2.0 * dt_s * max(floor, 1e-12 * float(np.abs(residual).max()) + 1e-300) ** 2
    level_dB = 10.0 * np.log10(np.maximum(rows / reference, 1e-3))
    time_s = np.linspace(0.0, residual.size * dt_s, starts.size + 1)
    return Map(time_s, edges_Hz, level_dB)


def _windowed_power(values: Array, dt_s: float, size: int, starts: NDArray[np.int64]) -> Array:
    """One-sided power density of every window about its mean, shape (windows, F) [unit^2 / Hz]."""
    window = np.hanning(size + 2)[1:-1]
    scale = 2.0 * dt_s / float(window @ window)
    power = np.empty((starts.size, size // 2 + 1))
    for k, first in enumerate(starts):
        part = values[first : first + size]
        power[k] = scale * np.abs(np.fft.rfft((part - part.mean()) * window)) ** 2
    return power


def _row(power: Array, frequency_Hz: Array, low: float, high: float) -> Array:
    """Mean power of the bins in a band, of the nearest where there is none, shape (windows,)."""
    inside = (frequency_Hz >= low) & (frequency_Hz < high)
    if not inside.any():
        inside[np.abs(frequency_Hz - np.sqrt(low * high)).argmin()] = True
    result: Array = power[:, inside].mean(axis=1)
    return result
