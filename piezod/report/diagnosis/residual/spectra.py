"""Spectrum of a residual, and its power over time and frequency relative to the noise floor."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array

COLUMNS, ROWS = 120, 96  # at most, of a map
SHORTEST, LONGEST = 64, 4096  # length of a window [samples]


@dataclass(frozen=True)
class PowerMap:
    """Power over time and frequency, in C columns and R rows.

    Parameters
    ----------
    time_s
        Edges of the columns since the first sample, shape (C + 1,) [s].
    frequency_Hz
        Edges of the rows, in a geometric series, shape (R + 1,) [Hz].
    level_dB
        Power above the noise floor, shape (R, C) [dB].
    """

    time_s: Array
    frequency_Hz: Array
    level_dB: Array


def spectrum(residual: Array, dt_s: float) -> tuple[Array, Array]:
    """Frequencies [Hz] and amplitude density [unit / sqrt(Hz)], each shape (F,).

    The density is the mean over half-overlapping Hann windows. Source: P. D. Welch, "The use of fast Fourier transform
    for the estimation of power spectra", IEEE Trans. Audio Electroacoust. 15 (1967) 70, DOI 10.1109/TAU.1967.1161901.

    Parameters
    ----------
    residual
        Residual, shape (N,).
    dt_s
        Sample period [s].
    """
    size = _window_size(residual.size)
    starts = np.arange(0, residual.size - size + 1, max(size // 2, 1))
    power = _windowed_power(residual, dt_s, size, starts).mean(axis=0)
    frequency_Hz: Array = np.fft.rfftfreq(size, dt_s)[1:].astype(np.float64)
    return frequency_Hz, np.sqrt(power[1:])


def windows_of(samples: int) -> int:
    """Number of windows over which `spectrum` averages a residual of so many samples."""
    size = _window_size(samples)
    return (samples - size) // max(size // 2, 1) + 1


def _window_size(samples: int) -> int:
    return min(max(samples // 8, SHORTEST), LONGEST, samples)


def time_frequency(residual: Array, dt_s: float, floor: float) -> PowerMap:
    """Power of a residual over time and frequency. White noise of standard deviation `floor` has 0 dB.

    Parameters
    ----------
    residual
        Residual, shape (N,).
    dt_s
        Sample period [s].
    floor
        Standard deviation of the noise, in the residual's unit.
    """
    size = int(np.clip(residual.size // (COLUMNS // 3), SHORTEST, LONGEST))
    size = min(size, residual.size)
    starts = np.unique(np.linspace(0, residual.size - size, COLUMNS).astype(int))
    power = _windowed_power(residual, dt_s, size, starts)
    frequency_Hz = np.fft.rfftfreq(size, dt_s).astype(np.float64)
    edges_Hz = np.geomspace(frequency_Hz[1], frequency_Hz[-1], ROWS + 1)
    rows = np.stack([_band_power(power, frequency_Hz, low, high) for low, high in itertools.pairwise(edges_Hz)])
    reference = 2.0 * dt_s * max(floor, 1e-12 * float(np.abs(residual).max()) + 1e-300) ** 2
    level_dB = 10.0 * np.log10(np.maximum(rows / reference, 1e-3))
    time_s = np.linspace(0.0, residual.size * dt_s, starts.size + 1)
    return PowerMap(time_s, edges_Hz, level_dB)


def _windowed_power(values: Array, dt_s: float, size: int, starts: NDArray[np.int64]) -> Array:
    """One-sided power density of each window without its mean, shape (windows, F) [unit^2 / Hz]."""
    window = np.hanning(size + 2)[1:-1]
    scale = 2.0 * dt_s / float(window @ window)
    power = np.empty((starts.size, size // 2 + 1))
    for k, first in enumerate(starts):
        part = values[first : first + size]
        power[k] = scale * np.abs(np.fft.rfft((part - part.mean()) * window)) ** 2
    return power


def _band_power(power: Array, frequency_Hz: Array, low_Hz: float, high_Hz: float) -> Array:
    """Mean power of the frequencies in a band, or power of the nearest frequency, shape (windows,)."""
    inside = (frequency_Hz >= low_Hz) & (frequency_Hz < high_Hz)
    if not inside.any():
        inside[np.abs(frequency_Hz - np.sqrt(low_Hz * high_Hz)).argmin()] = True
    result: Array = power[:, inside].mean(axis=1)
    return result
