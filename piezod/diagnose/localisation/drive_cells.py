"""Scores of a residual over the drive: voltage, rate, force, distance from the last reversal, direction, memory, band.

There are two kinds of references. The first is the residual, shifted circularly by a random time. The second is the
residual without its slow part, shifted and with a random sign of every block: a shift alone does not test a periodic
residual over a periodic drive.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Index, Mask
from piezod.diagnose.localisation import colour, coordinates
from piezod.diagnose.localisation.cells import (
    Cells,
    NormalisedResidual,
    distinct,
    excess_energy,
    references_at_once,
    standardised,
)

DRIVE_CELLS = 24
TAIL = (0.98, 0.99, 0.996)  # quantiles at which the highest cell is divided
BANDS_PER_DECADE = 6
HISTORY_TIMES = 12
SHORTEST_HISTORY, LONGEST_HISTORY = 8.0, 0.3  # samples; share of the duration
MOST_HISTORY_SAMPLES = 65_536  # more samples are averaged


@dataclass(frozen=True)
class _Axis:
    """Coordinate of the drive: edges of its cells, and for every sample 2 cell + (1 if rising)."""

    name: str
    edges: Array
    index: list[Index]

    @property
    def count(self) -> int:
        return max(self.edges.size - 1, 1)


def cells_of_drive(recordings: Sequence[NormalisedResidual], shifts: int, rng: np.random.Generator) -> list[Cells]:
    """Cells of every coordinate of the drive, over all recordings."""
    axes = _axes(recordings)
    sums = [np.zeros((2, 1 + shifts, 2 * axis.count)) for axis in axes]
    times = _history_times(recordings)
    pasts = np.zeros((2, 1 + shifts, 3 * (times.size - 1)))
    lengths = np.zeros(3 * (times.size - 1))
    bands = _band_edges(recordings)
    across = np.zeros((1 + shifts, bands.size - 1), complex)
    drive = np.zeros(bands.size - 1)
    for number, recording in enumerate(recordings):
        history = _History.of(recording, times, axes[0].index[number], axes[1].index[number])
        coherence = _Coherence.of(recording, bands)
        lengths += history.lengths
        drive += coherence.drive
        for rows, shifted, flipped in _references(recording, shifts, rng):
            for axis, axis_sums in zip(axes, sums, strict=True):
                axis_sums[0, rows] += _cell_sums(shifted, axis.index[number], 2 * axis.count)
                axis_sums[1, rows] += _cell_sums(flipped, axis.index[number], 2 * axis.count)
            pasts[0, rows] += history.products(shifted)
            pasts[1, rows] += history.products(flipped)
            across[rows] += coherence.products(flipped)
    counts = [_counts(recordings, axis) for axis in axes]
    cells = [_axis_cells(axis, axis_sums, n) for axis, axis_sums, n in zip(axes, sums, counts, strict=True)]
    cells.append(_direction_cells(sums[0], counts[0]))
    cells.append(_history_cells(times, pasts, lengths))
    cells.append(_band_cells(bands, across, drive))
    return cells


def _references(
    recording: NormalisedResidual, shifts: int, rng: np.random.Generator
) -> Iterator[tuple[slice, Array, Array]]:
    """Rows of both kinds of references, some at once; the first row is the residual itself."""
    size, blocks = recording.residual.size, recording.series.blocks
    fast = _without_slow_part(recording)
    lengths = [block.stop - block.start for block in blocks]
    at_once = references_at_once(size)
    for first in range(0, 1 + shifts, at_once):
        rows = slice(first, min(first + at_once, 1 + shifts))
        count = rows.stop - rows.start
        shifted, flipped = np.empty((count, size)), np.empty((count, size))
        for k in range(count):
            is_residual = first + k == 0
            shift = 0 if is_residual else int(rng.integers(size))
            signs = np.ones(len(blocks)) if is_residual else rng.choice((-1.0, 1.0), len(blocks))
            shifted[k] = np.roll(recording.residual, shift)
            flipped[k] = np.roll(fast * np.repeat(signs, lengths), shift)
        yield rows, shifted, flipped


def _without_slow_part(recording: NormalisedResidual) -> Array:
    """Residual without the line through the means of its blocks."""
    counts = recording.series.counts
    means, middles = [], []
    for block in recording.series.blocks:
        n = int(np.count_nonzero(counts[block]))
        if n:
            means.append(float(recording.residual[block].sum()) / n)
            middles.append(0.5 * (block.start + block.stop - 1))
    slow = np.interp(np.arange(recording.residual.size), middles, means)
    result: Array = np.where(counts, recording.residual - slow, 0.0)
    return result


@numba.njit(cache=True)
def _cell_sums(rows: Array, index: Index, cells: int) -> Array:
    out = np.zeros((rows.shape[0], cells))
    for k in range(rows.shape[0]):
        for n in range(rows.shape[1]):
            out[k, index[n]] += rows[k, n]
    return out


def _axes(recordings: Sequence[NormalisedResidual]) -> list[_Axis]:
    reversals = [coordinates.reversals(r.series.command_V) for r in recordings]
    values_of = {
        "voltage_V": [r.series.command_V for r in recordings],
        "rate_V_per_s": [np.abs(coordinates.rate(r.series.command_V, r.series.dt_s)) for r in recordings],
        "force_N": [r.modelled_N for r in recordings],
        "amplitude_V": [distance for _, distance in reversals],
    }
    axes = []
    for name, values in values_of.items():
        edges = distinct(coordinates.quantile_edges(np.concatenate(values), DRIVE_CELLS, TAIL))
        index = [
            2 * coordinates.cell_of(samples, edges) + (direction > 0.0)
            for samples, (direction, _) in zip(values, reversals, strict=True)
        ]
        axes.append(_Axis(name, edges, index))
    return axes


def _counts(recordings: Sequence[NormalisedResidual], axis: _Axis) -> Array:
    n = np.zeros(2 * axis.count)
    for recording, index in zip(recordings, axis.index, strict=True):
        n += np.bincount(index, weights=recording.series.counts.astype(np.float64), minlength=n.size)
    return n


def _axis_cells(axis: _Axis, sums: Array, counts: Array) -> Cells:
    falling, rising = sums[:, :, ::2], sums[:, :, 1::2]
    score = np.maximum(standardised(rising + falling).max(axis=0), standardised(rising - falling).max(axis=0))
    energy = excess_energy(sums[0] ** 2 / np.maximum(counts, 1.0))
    return Cells(
        axis.name, axis.edges[:-1], axis.edges[1:], score, energy[::2] + energy[1::2], np.zeros(axis.count, np.int64)
    )


def _direction_cells(sums: Array, counts: Array) -> Cells:
    both = np.stack((sums[:, :, ::2].sum(axis=2), sums[:, :, 1::2].sum(axis=2)), axis=2)
    n = np.array([counts[::2].sum(), counts[1::2].sum()])
    energy = excess_energy(both[0] ** 2 / np.maximum(n, 1.0)).sum()
    score = standardised(both[:, :, 1:] - both[:, :, :1]).max(axis=0)
    return Cells("direction", np.array([-1.0]), np.array([1.0]), score, np.array([energy]), np.zeros(1, np.int64))


def _history_times(recordings: Sequence[NormalisedResidual]) -> Array:
    dt_s = min(recording.series.dt_s for recording in recordings)
    longest = max(recording.series.duration_s for recording in recordings)
    return coordinates.times(dt_s, longest, HISTORY_TIMES, SHORTEST_HISTORY, LONGEST_HISTORY)


@dataclass(frozen=True)
class _History:
    """Band-passes of command, model and heating between neighbouring times, without their means over voltage and rate.

    `every`: number of samples averaged into a row of `columns`. `lengths`: squared norms of the columns.
    """

    columns: Array
    every: int
    lengths: Array

    @classmethod
    def of(cls, recording: NormalisedResidual, times_s: Array, voltage: Index, rate: Index) -> "_History":
        dt_s, counts = recording.series.dt_s, recording.series.counts
        every = -(-recording.residual.size // MOST_HISTORY_SAMPLES)
        heating = coordinates.rate(recording.series.command_V, dt_s) ** 2
        parts = []
        for values in (recording.series.command_V, recording.modelled_N, heating):
            scaled = (values - values.mean()) / max(float(values.std()), 1e-12)
            low = coordinates.low_passed(scaled, dt_s, times_s)
            bands = np.ascontiguousarray(low[:, :-1] - low[:, 1:])
            for _ in range(2):
                _remove_cell_means(bands, voltage, counts)
                _remove_cell_means(bands, rate, counts)
            parts.append(_averaged(bands.T, every))
        columns = np.ascontiguousarray(np.vstack(parts).T)
        return cls(columns, every, every * np.sum(columns**2, axis=0))

    def products(self, rows: Array) -> Array:
        return self.every * _averaged(rows, self.every) @ self.columns


def _averaged(rows: Array, every: int) -> Array:
    """Means of `every` samples each, shape (rows, N // every)."""
    if every == 1:
        return rows
    size = rows.shape[1] // every
    result: Array = rows[:, : size * every].reshape(rows.shape[0], size, every).mean(axis=2)
    return result


@numba.njit(cache=True)
def _remove_cell_means(columns: Array, index: Index, counts: Mask) -> None:
    cells = index.max() + 1
    sums, n = np.zeros((cells, columns.shape[1])), np.zeros(cells)
    for k in range(index.size):
        if counts[k]:
            n[index[k]] += 1.0
            for j in range(columns.shape[1]):
                sums[index[k], j] += columns[k, j]
    for k in range(index.size):
        for j in range(columns.shape[1]):
            if counts[k]:
                columns[k, j] -= sums[index[k], j] / n[index[k]]
            else:
                columns[k, j] = 0.0


def _history_cells(times_s: Array, products: Array, lengths: Array) -> Cells:
    score = standardised(products).max(axis=0).reshape(products.shape[1], 3, -1).max(axis=1)
    energy = excess_energy(products[0] ** 2 / np.maximum(lengths, 1e-9)).reshape(3, -1).max(axis=0)
    return Cells("history_s", times_s[:-1], times_s[1:], score, energy, np.zeros(times_s.size - 1, np.int64))


def _band_edges(recordings: Sequence[NormalisedResidual]) -> Array:
    highest = max(0.5 / recording.series.dt_s for recording in recordings)
    lowest = 8.0 / max(recording.series.duration_s for recording in recordings)
    count = max(int(np.ceil(BANDS_PER_DECADE * np.log10(highest / lowest))), 1)
    return np.geomspace(lowest, highest, count + 1)


@dataclass(frozen=True)
class _Coherence:
    """Spectrum of the simulated readings, divided into bands."""

    spectrum: NDArray[np.complex128]
    band: Index
    bands: int
    drive: Array

    @classmethod
    def of(cls, recording: NormalisedResidual, edges_Hz: Array) -> "_Coherence":
        size = recording.modelled_N.size
        spectrum = np.fft.rfft(colour.tapered(recording.modelled_N))
        frequency_Hz = np.fft.rfftfreq(size, recording.series.dt_s)
        band = np.searchsorted(edges_Hz, frequency_Hz, side="right")
        drive = np.bincount(band, weights=np.abs(spectrum) ** 2, minlength=edges_Hz.size + 1)
        return cls(spectrum.conj(), band, edges_Hz.size - 1, drive[1 : edges_Hz.size] * 2.0 / size)

    def products(self, rows: Array) -> NDArray[np.complex128]:
        """Cross-spectrum with the simulated readings in every band."""
        out = np.zeros((rows.shape[0], self.bands), complex)
        starts = np.searchsorted(self.band, np.arange(1, self.bands + 2))
        for k in range(rows.shape[0]):
            across = np.fft.rfft(rows[k]) * self.spectrum
            total = np.concatenate(([0.0], np.cumsum(across)))
            out[k] = (total[starts[1:]] - total[starts[:-1]]) * 2.0 / rows.shape[1]
        return out


def _band_cells(edges_Hz: Array, across: NDArray[np.complex128], drive: Array) -> Cells:
    energy = np.abs(across) ** 2 / np.maximum(drive, 1e-300)
    score = standardised(np.sqrt(energy)) * np.sign(energy - energy.mean(axis=0))
    return Cells(
        "frequency_Hz", edges_Hz[:-1], edges_Hz[1:], score, excess_energy(energy), np.zeros(edges_Hz.size - 1, np.int64)
    )
