"""Spectrum of a residual: autoregression, narrow lines, and the spectrum around them."""

import functools
import itertools

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.localisation import coordinates
from piezod.estimation.recordings.noise import MEDIAN_SPREAD

ORDER = 12  # order of the autoregression
SHORTEST_STRETCH, MOST_STRETCHES = 1000, 24  # samples in a stretch and stretches for the autoregression
QUIET_SHARE = 0.75  # share of the stretches that is used, the quietest first: bursts and steps are not
WIDEST, NARROWEST, GROWTH = 101, 16, 0.25  # width of the bins around a line, and its growth with frequency
SLOWEST_LINE = 16  # lowest frequency of a line [cycles per record]
DRIVEN, DRIVEN_SHARE = 50.0, 1e-5  # power of a driven bin over that around it, and over the total power


def spread(values: Array) -> float:
    """Standard deviation from the median absolute deviation."""
    return MEDIAN_SPREAD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def autoregression(residual: Array) -> Array:
    """Coefficients that predict a residual from its past, shape (ORDER,) [1].

    Autocovariances are means over the stretches with the least power, without bursts and steps.
    """
    stretches = int(np.clip(residual.size // SHORTEST_STRETCH, 1, MOST_STRETCHES))
    size = residual.size // stretches
    parts = residual[: stretches * size].reshape(stretches, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    power = np.mean(parts**2, axis=1)
    quiet = parts[power <= np.quantile(power, QUIET_SHARE)]
    lags = np.array([np.sum(quiet[:, k:] * quiet[:, : size - k]) for k in range(ORDER + 1)])
    if not lags[0] > 0.0:
        return np.zeros(ORDER)
    index = np.abs(np.arange(ORDER)[:, None] - np.arange(ORDER))
    matrix = lags[index] + 1e-9 * lags[0] * np.eye(ORDER)
    result: Array = np.linalg.lstsq(matrix, lags[1:], rcond=None)[0]
    return result


def correlation_length(residual: Array) -> float:
    """Correlation length [samples]: variance of the mean times the number of samples, over the variance."""
    coefficients = autoregression(residual)
    variance = float(np.mean(residual**2))
    at_zero = float(np.mean(innovations(residual, coefficients) ** 2)) / max(1.0 - float(coefficients.sum()), 1e-3) ** 2
    return max(at_zero / max(variance, 1e-300), 1.0)


def innovations(residual: Array, coefficients: Array | None = None) -> Array:
    """Error of the prediction of a residual from its past, shape (N,); 0 for the first ORDER samples."""
    predictor = autoregression(residual) if coefficients is None else coefficients
    out: Array = residual - np.convolve(residual, np.concatenate(([0.0], predictor)))[: residual.size]
    out[: predictor.size] = 0.0
    return out


def surroundings(power: Array) -> Array:
    """Power around every bin, from medians of bands that widen with frequency, shape (..., bins)."""
    edges = _chunks(power.shape[-1])
    medians = np.stack([np.median(power[..., a:b], axis=-1) for a, b in itertools.pairwise(edges)], axis=-1)
    index = np.repeat(np.arange(edges.size - 1), np.diff(edges))
    last = edges.size - 2
    around = np.maximum(medians[..., np.maximum(index - 1, 0)], medians[..., np.minimum(index + 1, last)])
    result: Array = np.maximum(around, medians[..., index]) / np.log(2.0)
    return result


@functools.cache
def _chunks(bins: int) -> NDArray[np.int64]:
    edges = [0]
    while edges[-1] < bins:
        edges.append(edges[-1] + int(np.clip(GROWTH * edges[-1], NARROWEST, WIDEST)))
    edges[-1] = bins
    if len(edges) > 2 and edges[-1] - edges[-2] < NARROWEST:
        del edges[-2]
    return np.array(edges)


def prominence(spectrum: NDArray[np.complex128], slowest: int = SLOWEST_LINE) -> Array:
    """Power of every bin over that around it; exponential with mean up to 1 for a smooth spectrum."""
    power: Array = np.abs(spectrum) ** 2
    around = surroundings(power)
    result: Array = power / np.maximum(around, 1e-300)
    result[..., :slowest] = 0.0
    result[..., -1] = 0.0
    return result


def tapered(values: Array) -> Array:
    """Values without their mean, tapered to 0 over a tenth of the record at either end, against leakage."""
    count = values.size // 10
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / max(count, 1))
    result: Array = values - values.mean()
    result[:count] *= rise
    result[values.size - count :] *= rise[::-1]
    return result


def windowed_spectrum(values: Array) -> NDArray[np.complex128]:
    """Fourier transform under a Hann window, shape (N // 2 + 1,)."""
    result: NDArray[np.complex128] = np.fft.rfft((values - values.mean()) * np.hanning(values.size))
    return result


def driven_bins(command_V: Array, modelled_N: Array) -> NDArray[np.bool_]:
    """Bins in which command, model, direction or speed have a line, shape (N // 2 + 1,)."""
    direction, _ = coordinates.reversals(command_V)
    driven = np.zeros(command_V.size // 2 + 1, bool)
    for drive in (command_V, modelled_N, direction, np.abs(np.gradient(command_V))):
        spectrum = windowed_spectrum(drive)
        strong = np.abs(spectrum) ** 2 > DRIVEN_SHARE * np.sum(np.abs(spectrum) ** 2)
        driven |= (prominence(spectrum) > DRIVEN) & strong
    wide = driven.copy()
    for shift in (1, 2):
        wide[shift:] |= driven[:-shift]
        wide[:-shift] |= driven[shift:]
    return wide


def refined_frequency_Hz(values: Array, dt_s: float, near_Hz: float) -> float:
    """Frequency within a bin at which a line has the most power, on a fine grid [Hz]."""
    bin_Hz = 1.0 / (values.size * dt_s)
    grid_Hz = near_Hz + bin_Hz * np.linspace(-1.0, 1.0, 41)
    weighted = np.hanning(values.size) * values
    turns = np.exp(-2j * np.pi * dt_s * near_Hz * np.arange(values.size)) * weighted
    slow = _decimated(turns, 256)
    at_s = (np.arange(slow.size) + 0.5) * (values.size / slow.size) * dt_s
    power = np.abs(np.exp(-2j * np.pi * np.outer(grid_Hz - near_Hz, at_s)) @ slow)
    return float(grid_Hz[int(np.argmax(power))])


def _decimated(values: NDArray[np.complex128], parts: int) -> NDArray[np.complex128]:
    edges = np.linspace(0, values.size, min(parts, values.size) + 1).astype(int)[:-1]
    result: NDArray[np.complex128] = np.add.reduceat(values, edges)
    return result
