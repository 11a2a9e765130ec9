"""The colour of a residual: what a stationary noise with its spectrum would show by itself."""

import functools
import itertools

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDER = 12  # of the autoregression
SHORTEST_STRETCH, MOST_STRETCHES = 1000, 24  # samples; stretches that it is taken from
USUAL = 0.75  # of the stretches, those with least power
MEDIAN_SPREAD = 1.4826  # standard deviation over median absolute deviation of a Gaussian
WIDEST, NARROWEST, GROWTH = 101, 16, 0.25  # bins of a line's surroundings; their growth with frequency
SLOWEST_LINE = 16  # cycles a record
DRIVEN, DRIVEN_PART = 50.0, 1e-5  # power of a bin over its surroundings, and of all, for the drive to be in it


def spread(values: Array) -> float:
    """Standard deviation from the median absolute deviation."""
    return MEDIAN_SPREAD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def autoregression(residual: Array) -> Array:
    """Coefficients that predict a residual from its past, shape (ORDER,) [1].

    Autocovariances are means over stretches of usual power, so a burst or a step does not decide.
    """
    stretches = int(np.clip(residual.size // SHORTEST_STRETCH, 1, MOST_STRETCHES))
    size = residual.size // stretches
    parts = residual[: stretches * size].reshape(stretches, size)
    parts = parts - parts.mean(axis=1, keepdims=True)
    power = np.mean(parts**2, axis=1)
    usual = parts[power <= np.quantile(power, USUAL)]
    lags = np.array([np.sum(usual[:, k:] * usual[:, : size - k]) for k in range(ORDER + 1)])
    if not lags[0] > 0.0:
        return np.zeros(ORDER)
    index = np.abs(np.arange(ORDER)[:, None] - np.arange(ORDER))
    matrix = lags[index] + 1e-9 * lags[0] * np.eye(ORDER)
    result: Array = np.linalg.lstsq(matrix, lags[1:], rcond=None)[0]
    return result


def memory(residual: Array) -> float:
    """How many samples long a residual remembers: variance of its mean over that of its values, per sample [1]."""
    coefficients = autoregression(residual)
    left = innovations(residual, coefficients)
    variance = float(np.mean(residual**2))
    at_zero = float(np.mean(left**2)) / max(1.0 - float(coefficients.sum()), 1e-3) ** 2
    return max(at_zero / max(variance, 1e-300), 1.0)


def innovations(residual: Array, coefficients: Array | None = None) -> Array:
    """What a residual's own past does not foretell, shape (N,); 0 for the first ORDER samples."""
    predictor = autoregression(residual) if coefficients is None else coefficients
    out: Array = residual - np.convolve(residual, np.concatenate(([0.0], predictor)))[: residual.size]
    out[: predictor.size] = 0.0
    return out


def surroundings(power: Array) -> Array:
    """Power around every bin, from medians of chunks that grow with frequency, shape (..., bins)."""
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
    """Power of every bin over its surroundings; exponential with mean up to 1 for a smooth spectrum."""
    power: Array = np.abs(spectrum) ** 2
    around = surroundings(power)
    result: Array = power / np.maximum(around, 1e-300)
    result[..., :slowest] = 0.0
    result[..., -1] = 0.0
    return result


def tapered(values: Array) -> Array:
    """Values about their mean, brought to 0 over a tenth of the record at either end, so its ends do not leak."""
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


def driven_bins(*drives: Array) -> NDArray[np.bool_]:
    """Bins in which one of the drives has a line of its own, shape (N // 2 + 1,)."""
    bins = drives[0].size // 2 + 1
    driven = np.zeros(bins, bool)
    for one in drives:
        spectrum = windowed_spectrum(one)
        strong = np.abs(spectrum) ** 2 > DRIVEN_PART * np.sum(np.abs(spectrum) ** 2)
        driven |= (prominence(spectrum) > DRIVEN) & strong
    wide = driven.copy()
    for shift in (1, 2):
        wide[shift:] |= driven[:-shift]
        wide[:-shift] |= driven[shift:]
    return wide


def refined_frequency_Hz(values: Array, dt_s: float, near_Hz: float) -> float:
    """Where a line's power is greatest within a bin, on a fine grid [Hz]."""
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
