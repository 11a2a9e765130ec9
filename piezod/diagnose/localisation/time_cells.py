"""Scores of a residual over time, temperature and narrow lines, which no circular shift changes.

The references are random: independent cells with the spread of neighbouring cells, and noise with the spectrum around a
line.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Index
from piezod.diagnose.localisation import colour, coordinates
from piezod.diagnose.localisation.cells import Cells, NormalisedResidual, distinct, references_at_once
from piezod.estimation.recordings.noise import MEDIAN_SPREAD
from piezod.estimation.recordings.series import Series

FEWEST_TIME_CELLS, TIME_CELLS, FINE_CELLS = 12, 48, 480
CORRELATION_LENGTHS = 16.0  # least length of a time cell, so that cells are nearly independent
TEMPERATURE_CELLS = 12
LINE_BANDS = 200
CLEAR_LINE = 12.0  # power over that around it above which the frequency of a line is refined


def cells_of_time_and_temperature(
    recordings: Sequence[NormalisedResidual], shifts: int, rng: np.random.Generator
) -> list[Cells]:
    """Cells of level and power over the time of each recording, and of level over the temperature if it is recorded."""
    cells, levels, temperatures, sums = [], [], [], []
    for recording in recordings:
        length = colour.correlation_length(recording.residual)
        count = recording.residual.size / (CORRELATION_LENGTHS * length)
        coarse_cells = int(np.clip(count, FEWEST_TIME_CELLS, TIME_CELLS))
        coarse = _Stretches.of(recording, recording.residual, coarse_cells)
        level = _in_spreads(np.vstack((coarse.mean, rng.standard_normal((shifts, coarse.mean.size)))))
        cells.append(_level_cells(recording, coarse, level))
        innovations = colour.innovations(recording.residual)
        stretches = [_Stretches.of(recording, innovations, number) for number in (TIME_CELLS, FINE_CELLS)]
        cells += [_power_cells(recording, some, shifts, rng) for some in stretches]
        if recording.series.temperature_C is not None:
            levels.append(level)
            sums.append(np.vstack((coarse.n, coarse.n * (coarse.mean - np.median(coarse.mean)))).T)
            temperatures.append(_Stretches.of(recording, recording.series.temperature_C, coarse_cells).mean)
    if levels and float(np.ptp(np.concatenate(temperatures))) > 0.0:
        cells.append(_temperature_cells(np.hstack(levels), np.concatenate(temperatures), np.concatenate(sums)))
    return cells


@dataclass(frozen=True)
class _Stretches:
    """Cells of equal duration: number of readings that count, their mean and their mean square, shape (C,)."""

    edges: Index
    n: Array
    mean: Array
    power: Array

    @classmethod
    def of(cls, recording: NormalisedResidual, values: Array, cells: int) -> "_Stretches":
        edges = np.linspace(0, values.size, min(cells, values.size // 8) + 1).astype(np.int64)
        counts = recording.series.counts.astype(np.float64)
        n = np.add.reduceat(counts, edges[:-1])
        safe = np.maximum(n, 1.0)
        mean = np.add.reduceat(values * counts, edges[:-1]) / safe
        power = np.add.reduceat(values**2 * counts, edges[:-1]) / safe
        empty = n < 0.5 * np.diff(edges)  # too few readings: the median of the others replaces them
        mean[empty], power[empty] = np.median(mean[~empty]), np.median(power[~empty])
        return cls(edges, n, mean, power)

    def times_s(self, series: Series) -> tuple[Array, Array]:
        edges_s = series.start_s + self.edges.astype(np.float64) * series.dt_s
        return edges_s[:-1], edges_s[1:]


def _in_spreads(values: Array) -> Array:
    """Values without their median, in units of the spread of neighbouring cells, shape (1 + references, C)."""
    centred = values - np.median(values, axis=1, keepdims=True)
    scales = []
    for lag in (1, 2, 3):
        steps = np.abs(values[:, lag:] - values[:, :-lag])
        scales.append(MEDIAN_SPREAD * np.median(steps, axis=1, keepdims=True) / np.sqrt(2.0))
    result: Array = centred / np.maximum(np.maximum.reduce(scales), 1e-12)
    return result


def _level_cells(recording: NormalisedResidual, stretches: _Stretches, level: Array) -> Cells:
    low, high = stretches.times_s(recording.series)
    energy = stretches.n * (stretches.mean - np.median(stretches.mean)) ** 2
    return Cells("time_s", low, high, np.abs(level), energy, (level[0] > 0.0).astype(np.int64))


def _power_cells(recording: NormalisedResidual, stretches: _Stretches, shifts: int, rng: np.random.Generator) -> Cells:
    """Cells of power; cube roots of mean squares are nearly normal (E. Wilson, M. Hilferty, 1931)."""
    low, high = stretches.times_s(recording.series)
    degrees = float(np.diff(stretches.edges).mean())
    reference = rng.chisquare(degrees, (shifts, low.size)) / degrees
    score = _in_spreads(
        np.cbrt(np.vstack((stretches.power / max(float(np.median(stretches.power)), 1e-300), reference)))
    )
    energy = stretches.n * np.maximum(stretches.power - np.median(stretches.power), 0.0)
    return Cells("time_s", low, high, score, energy, np.zeros(low.size, np.int64))


def _temperature_cells(level: Array, temperature_C: Array, counts_and_sums: Array) -> Cells:
    """Cells of temperature, from the levels, temperatures, and numbers and sums of readings of the cells of time."""
    edges = distinct(coordinates.quantile_edges(temperature_C, TEMPERATURE_CELLS))
    index = coordinates.cell_of(temperature_C, edges)
    cells = edges.size - 1
    root = np.sqrt(np.maximum(np.bincount(index, minlength=cells), 1.0))
    score = np.abs(np.stack([np.bincount(index, weights=row, minlength=cells) for row in level])) / root
    n, sums = (np.bincount(index, weights=column, minlength=cells) for column in counts_and_sums.T)
    energy = sums**2 / np.maximum(n, 1.0)
    return Cells("temperature_C", edges[:-1], edges[1:], score, energy, (sums > 0.0).astype(np.int64))


def cells_of_lines(recordings: Sequence[NormalisedResidual], shifts: int, rng: np.random.Generator) -> list[Cells]:
    """Cells of the narrow lines of each recording."""
    return [_lines_of(recording, shifts, rng) for recording in recordings]


def _lines_of(recording: NormalisedResidual, shifts: int, rng: np.random.Generator) -> Cells:
    """Highest line in each band, without lines of the drive."""
    series = recording.series
    driven = colour.driven_bins(series.command_V, recording.modelled_N)
    spectrum = colour.windowed_spectrum(recording.residual)
    starts = np.unique(np.linspace(0, driven.size, LINE_BANDS + 1).astype(int)[:-1])
    free = np.flatnonzero(~driven)
    power = np.abs(spectrum) ** 2
    over = colour.prominence(spectrum) * ~driven
    score = np.empty((1 + shifts, starts.size))
    score[0] = np.maximum.reduceat(over, starts)
    at_once = references_at_once(driven.size)
    for first in range(1, 1 + shifts, at_once):
        count = min(at_once, 1 + shifts - first)
        noise = colour.prominence(_windowed_noise(count, driven.size, rng)) * ~driven
        score[first : first + count] = np.maximum.reduceat(noise, starts, axis=1)
    peaks = np.array([_highest(over, a, b) for a, b in zip(starts, [*starts[1:], driven.size], strict=True)])
    size = series.command_V.size
    bin_Hz = 1.0 / (size * series.dt_s)
    at_Hz = np.array([_line_Hz(recording, peak, over[peak], bin_Hz) for peak in peaks])
    around = colour.surroundings(power)
    # a Hann window spreads the energy of a line over 1.5 bins and keeps 3/8 of it
    energy = np.maximum(power[peaks] - around[peaks], 0.0) * 8.0 / size if free.size else np.zeros(peaks.size)
    return Cells("frequency_Hz", at_Hz, at_Hz, score, energy, np.arange(peaks.size))


def _line_Hz(recording: NormalisedResidual, peak: int, over: float, bin_Hz: float) -> float:
    if over < CLEAR_LINE:
        return peak * bin_Hz
    return colour.refined_frequency_Hz(recording.residual, recording.series.dt_s, peak * bin_Hz)


def _highest(values: Array, first: int, end: int) -> int:
    return first + int(np.argmax(values[first:end]))


def _windowed_noise(count: int, bins: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Spectra of white noise under a Hann window, shape (count, bins)."""
    parts = rng.standard_normal((2, count, bins + 2))
    noise = parts[0] + 1j * parts[1]
    result: NDArray[np.complex128] = 0.5 * noise[:, 1:-1] - 0.25 * (noise[:, 2:] + noise[:, :-2])
    return result
