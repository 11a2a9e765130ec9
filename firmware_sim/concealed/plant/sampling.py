"""From a signal on the grid to readings: interpolation, tones, random walks, noise, converter, frozen readings."""

from collections.abc import Sequence

import numpy as np

from firmware_sim.concealed.plant.arrays import Array

DROPOUTS = ("exact", "noisy", "rail")
RAIL = 1.25  # full scale of the converter [full force]
NEAR = 1e-6  # [grid steps]; a position this close to a point is on the point


def tone(time_s: Array, frequency_Hz: float, phase: Array) -> Array:
    """Sine with a phase [rad] for every time, shape (n,) (1).

    Parameters
    ----------
    time_s
        Times, shape (n,) [s].
    frequency_Hz
        Frequency [Hz].
    phase
        Phase, shape (n,) [rad].
    """
    return np.sin(2.0 * np.pi * frequency_Hz * time_s + phase)


def wander(rng: np.random.Generator, time_s: Array, correlation_s: float) -> Array:
    """Smooth stationary random signal of standard deviation 1, shape (n,) (1).

    Parameters
    ----------
    rng
        Source of the random draws.
    time_s
        Ascending times from 0, shape (n,) [s].
    correlation_s
        Correlation time [s], above 0.
    """
    every_s = 0.25 * correlation_s
    knots = rng.normal(0.0, 1.0, int(time_s[-1] / every_s) + 8)
    smooth = np.convolve(knots, np.array([0.5, 1.0, 0.5]) / 1.5**0.5, mode="same")
    return np.interp(time_s, every_s * np.arange(knots.size), smooth)


def read_at(signal: Array, positions: Array, *, held: bool) -> Array:
    """Values of a signal between the points of its grid, shape (n,).

    Parameters
    ----------
    signal
        Values on the grid, shape (m,); constant before the first point.
    positions
        Positions to read [grid steps], shape (n,).
    held
        True: the value of the point before. False: the cubic through the four nearest points.
    """
    last = signal.size - 1
    whole = np.floor(positions + NEAR).astype(np.int64)
    if held:
        whole_steps: Array = signal[whole.clip(0, last)]
        return whole_steps
    x = np.where(np.abs(positions - whole) < NEAR, 0.0, positions - whole)
    a, b, c, d = (signal[(whole + k).clip(0, last)] for k in (-1, 0, 1, 2))
    cubic = (
        -a * x * (x - 1.0) * (x - 2.0) / 6.0
        + b * (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0
        - c * (x + 1.0) * x * (x - 2.0) / 2.0
        + d * (x + 1.0) * x * (x - 1.0) / 6.0
    )
    result: Array = np.where(positions <= 0.0, signal[0], cubic)
    return result


def noise(rng: np.random.Generator, samples: int, rms: float, kind: str, rate_Hz: float, corner_Hz: float) -> Array:
    """Noise of a given rms, shape (n,); of `coloured` noise, half the power lies below the corner.

    Parameters
    ----------
    rng
        Source of the random draws.
    rms
        Standard deviation, in the unit of the result.
    kind
        "coloured", "white", or "quantised", which is white here.
    rate_Hz
        Sample rate [Hz].
    corner_Hz
        Corner of coloured noise [Hz]; white noise does not use it.
    """
    if kind not in ("white", "coloured", "quantised"):
        raise ValueError(f"noise is {kind!r}, must be white, coloured or quantised")
    white = rng.normal(0.0, 1.0, samples)
    if kind != "coloured":
        return rms * white
    keep = float(np.exp(-2.0 * np.pi * corner_Hz / rate_Hz))
    fresh = rng.normal(0.0, np.sqrt(1.0 - keep * keep), samples)
    fresh[0] = rng.normal()
    result: Array = rms * np.sqrt(0.5) * (white + _forgetting_sum(fresh, keep))
    return result


def quantised(values: Array, step: float) -> Array:
    """Values rounded to the steps of a converter, shape (n,).

    Parameters
    ----------
    values
        Readings, shape (n,).
    step
        Step of the converter [unit of a reading], above 0.
    """
    return step * np.rint(values / step)


def frozen(values: Array, time_s: Array, spans_s: Sequence[tuple[float, float]]) -> Array:
    """Readings that keep their last value during given spans (start, end) [s], shape (n,).

    Parameters
    ----------
    values
        Readings, shape (n,).
    time_s
        Ascending times, shape (n,) [s].
    spans_s
        Spans (start, end) [s].
    """
    result = values.copy()
    for start_s, end_s in spans_s:
        first, end = np.searchsorted(time_s, [start_s - 1e-9, end_s - 1e-9])
        result[first:end] = values[max(first - 1, 0)]
    return result


def at_rail(values: Array, time_s: Array, spans_s: Sequence[tuple[float, float]], rail: float) -> Array:
    """Readings that stand at a rail during given spans (start, end) [s], shape (n,).

    Parameters
    ----------
    values, time_s, spans_s
        As for `frozen`.
    """
    result = values.copy()
    for start_s, end_s in spans_s:
        first, end = np.searchsorted(time_s, [start_s - 1e-9, end_s - 1e-9])
        result[first:end] = rail
    return result


def _forgetting_sum(fresh: Array, keep: float) -> Array:
    """x_k = keep x_{k-1} + fresh_k, in blocks in which the powers of `keep` do not underflow."""
    block = max(1, int(30.0 / -np.log(keep)))
    powers = keep ** np.arange(1, block + 1)
    result, last = np.empty(fresh.size), 0.0
    for start in range(0, fresh.size, block):
        part = fresh[start : start + block]
        p = powers[: part.size]
        result[start : start + block] = p * (last + np.cumsum(part / p))
        last = float(result[start + part.size - 1])
    return result
