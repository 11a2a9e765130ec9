"""Scores of a residual over time, temperature and narrow lines, which no circular shift changes.

Their references are drawn: independent cells, as uneven as neighbours are; and noise with the spectrum of a line's
surroundings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.localisation import colour, coordinates
from piezod.diagnose.localisation.cells import Cells, Told, distinct, together

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FEWEST_TIME_CELLS, TIME_CELLS, FINE_CELLS = 12, 48, 480
MEMORIES = 16.0  # that a cell of time is long at least
TEMPERATURE_CELLS = 12
LINE_BANDS = 200
SURE_LINE = 12.0  # power over the surroundings from which a line's frequency is refined


def cells_of_time_and_temperature(told: Sequence[Told], shifts: int, rng: np.random.Generator) -> list[Cells]:
    """Level and power over each recording's time, and level over the temperature where it is known."""
    cells, means, temperatures, raw = [], [], [], []
    for one in told:
        memory = colour.memory(one.residual)
        long = int(np.clip(one.residual.size / (MEMORIES * memory), FEWEST_TIME_CELLS, TIME_CELLS))
        coarse = _Stretches.of(one, one.residual, long)
        level = np.vstack((coarse.mean, rng.standard_normal((shifts, coarse.mean.size))))
        level = _uneven(level)
        cells.append(_level_cells(one, coarse, level))
        news = colour.innovations(one.residual)
        cells += [_power_cells(one, _Stretches.of(one, news, many), shifts, rng) for many in (TIME_CELLS, FINE_CELLS)]
        if one.series.temperature_C is not None:
            means.append(level)
            raw.append(np.vstack((coarse.n, coarse.n * (coarse.mean - np.median(coarse.mean)))).T)
            temperatures.append(_Stretches.of(one, one.series.temperature_C, long).mean)
    if means and float(np.ptp(np.concatenate(temperatures))) > 0.0:
        cells.append(_temperature_cells(np.hstack(means), np.concatenate(temperatures), np.concatenate(raw)))
    return cells


@dataclass(frozen=True)
class _Stretches:
    """Cells of equal time: how many readings count in each, their mean and their mean square."""

    edges: Index
    n: Array
    mean: Array
    power: Array

    @classmethod
    def of(cls, one: Told, values: Array, cells: int) -> "_Stretches":
        edges = np.linspace(0, values.size, min(cells, values.size // 8) + 1).astype(np.int64)
        counts = one.series.counts.astype(np.float64)
        n = np.add.reduceat(counts, edges[:-1])
        safe = np.maximum(n, 1.0)
        mean = np.add.reduceat(values * counts, edges[:-1]) / safe
        power = np.add.reduceat(values**2 * counts, edges[:-1]) / safe
        empty = n < 0.5 * np.diff(edges)  # too few readings: neither more nor less than others
        mean[empty], power[empty] = np.median(mean[~empty]), np.median(power[~empty])
        return cls(edges, n, mean, power)

    def times_s(self, one: Told) -> tuple[Array, Array]:
        at_s = one.series.start_s + self.edges.astype(np.float64) * one.series.dt_s
        return at_s[:-1], at_s[1:]


def _uneven(values: Array) -> Array:
    """Cells about their median, in units of how much neighbours differ, shape (1 + shifts, C)."""
    centred = values - np.median(values, axis=1, keepdims=True)
    scales = []
    for lag in (1, 2, 3):
        steps = np.abs(values[:, lag:] - values[:, :-lag])
        scales.append(colour.MEDIAN_SPREAD * np.median(steps, axis=1, keepdims=True) / np.sqrt(2.0))
    result: Array = centred / np.maximum(np.maximum.reduce(scales), 1e-12)
    return result


def _level_cells(one: Told, stretches: _Stretches, level: Array) -> Cells:
    low, high = stretches.times_s(one)
    energy = stretches.n * (stretches.mean - np.median(stretches.mean)) ** 2
    return Cells("time_s", low, high, np.abs(level), energy, (level[0] > 0.0).astype(np.int64))


def _power_cells(one: Told, stretches: _Stretches, shifts: int, rng: np.random.Generator) -> Cells:
    """Cells with more power than others; a cube root makes mean squares nearly Gaussian (Wilson, Hilferty 1931)."""
    low, high = stretches.times_s(one)
    degrees = float(np.diff(stretches.edges).mean())
    reference = rng.chisquare(degrees, (shifts, low.size)) / degrees
    score = _uneven(np.cbrt(np.vstack((stretches.power / max(float(np.median(stretches.power)), 1e-300), reference))))
    energy = stretches.n * np.maximum(stretches.power - np.median(stretches.power), 0.0)
    return Cells("time_s", low, high, score, energy, np.zeros(low.size, np.int64))


def _temperature_cells(level: Array, temperature_C: Array, raw: Array) -> Cells:
    """Cells of temperature, from cells of time: their scores, temperatures, and readings and sums in them."""
    edges = distinct(coordinates.quantile_edges(temperature_C, TEMPERATURE_CELLS))
    index = coordinates.cell_of(temperature_C, edges)
    cells = edges.size - 1
    many = np.sqrt(np.maximum(np.bincount(index, minlength=cells), 1.0))
    score = np.abs(np.stack([np.bincount(index, weights=row, minlength=cells) for row in level])) / many
    n, sums = (np.bincount(index, weights=column, minlength=cells) for column in raw.T)
    energy = sums**2 / np.maximum(n, 1.0)
    return Cells("temperature_C", edges[:-1], edges[1:], score, energy, (sums > 0.0).astype(np.int64))


def cells_of_lines(told: Sequence[Told], shifts: int, rng: np.random.Generator) -> list[Cells]:
    """Narrow lines of each recording."""
    return [_lines_of(one, shifts, rng) for one in told]


def _lines_of(one: Told, shifts: int, rng: np.random.Generator) -> Cells:
    """Narrow peaks over their surroundings that the drive has not, the highest in each of many bands."""
    u = one.series.command_V
    direction, _ = coordinates.reversals(u)
    driven = colour.driven_bins(u, one.modelled_N, direction, np.abs(np.gradient(u)))
    spectrum = colour.windowed_spectrum(one.residual)
    starts = np.unique(np.linspace(0, driven.size, LINE_BANDS + 1).astype(int)[:-1])
    free = np.flatnonzero(~driven)
    power = np.abs(spectrum) ** 2
    over = colour.prominence(spectrum) * ~driven
    score = np.empty((1 + shifts, starts.size))
    score[0] = np.maximum.reduceat(over, starts)
    many = together(driven.size)
    for first in range(1, 1 + shifts, many):
        count = min(many, 1 + shifts - first)
        noise = colour.prominence(_windowed_noise(count, driven.size, rng)) * ~driven
        score[first : first + count] = np.maximum.reduceat(noise, starts, axis=1)
    peaks = np.array([_highest(over, a, b) for a, b in zip(starts, [*starts[1:], driven.size], strict=True)])
    bin_Hz = 1.0 / (u.size * one.series.dt_s)
    at_Hz = np.array([_line_Hz(one, peak, over[peak], bin_Hz) for peak in peaks])
    around = colour.surroundings(power)
    # a Hann window spreads a line's energy over 1.5 bins and keeps 3/8 of it
    energy = np.maximum(power[peaks] - around[peaks], 0.0) * 8.0 / u.size if free.size else np.zeros(peaks.size)
    return Cells("frequency_Hz", at_Hz, at_Hz, score, energy, np.arange(peaks.size))


def _line_Hz(one: Told, peak: int, over: float, bin_Hz: float) -> float:
    if over < SURE_LINE:
        return peak * bin_Hz
    return colour.refined_frequency_Hz(one.residual, one.series.dt_s, peak * bin_Hz)


def _highest(values: Array, first: int, end: int) -> int:
    return first + int(np.argmax(values[first:end]))


def _windowed_noise(count: int, bins: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Spectra of white noise under a Hann window, shape (count, bins)."""
    parts = rng.standard_normal((2, count, bins + 2))
    noise = parts[0] + 1j * parts[1]
    result: NDArray[np.complex128] = 0.5 * noise[:, 1:-1] - 0.25 * (noise[:, 2:] + noise[:, :-2])
    return result
