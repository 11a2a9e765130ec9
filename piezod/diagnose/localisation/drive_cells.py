"""Scores of a residual over the drive: voltage, rate, force, way since the last reversal, direction, past, coherence.

The references are the residual itself, shifted circularly by a random time within its recording; and shifted with the
sign of every block drawn and its slow part taken away, since the shift of a periodic residual over a periodic drive
says nothing.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.localisation import colour, coordinates
from piezod.diagnose.localisation.cells import Cells, Told, beyond, distinct, standard, together

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

DRIVE_CELLS = 24
TAIL = (0.98, 0.99, 0.996)  # quantiles at which the highest cell is cut again
BANDS_PER_DECADE = 6
HISTORY_TIMES = 12
SHORTEST_HISTORY, LONGEST_HISTORY = 8.0, 0.3  # samples; part of the duration
MOST_HISTORY_SAMPLES = 65_536


@dataclass(frozen=True)
class _Axis:
    """A coordinate of the drive: its edges, and every sample's cell and direction (2 cell + rising)."""

    name: str
    edges: Array
    index: list[Index]

    @property
    def count(self) -> int:
        return max(self.edges.size - 1, 1)


def cells_of_drive(told: Sequence[Told], shifts: int, rng: np.random.Generator) -> list[Cells]:
    """Every coordinate of the drive, over all recordings."""
    axes = _axes(told)
    sums = [np.zeros((2, 1 + shifts, 2 * one.count)) for one in axes]
    times = _history_times(told)
    pasts = np.zeros((2, 1 + shifts, 3 * (times.size - 1)))
    lengths = np.zeros(3 * (times.size - 1))
    bands = _band_edges(told)
    across = np.zeros((1 + shifts, bands.size - 1), complex)
    drive = np.zeros(bands.size - 1)
    for number, one in enumerate(told):
        history = _History.of(one, times, axes[0].index[number], axes[1].index[number])
        coherence = _Coherence.of(one, bands)
        lengths += history.lengths
        drive += coherence.drive
        for rows, shifted, flipped in _references(one, shifts, rng):
            for axis, place in zip(axes, sums, strict=True):
                place[0, rows] += _cell_sums(shifted, axis.index[number], 2 * axis.count)
                place[1, rows] += _cell_sums(flipped, axis.index[number], 2 * axis.count)
            pasts[0, rows] += history.products(shifted)
            pasts[1, rows] += history.products(flipped)
            across[rows] += coherence.products(flipped)
    counts = [_counts(told, axis) for axis in axes]
    cells = [_axis_cells(axis, place, n) for axis, place, n in zip(axes, sums, counts, strict=True)]
    cells.append(_direction_cells(sums[0], counts[0]))
    cells.append(_history_cells(times, pasts, lengths))
    cells.append(_band_cells(bands, across, drive))
    return cells


def _references(one: Told, shifts: int, rng: np.random.Generator) -> Iterator[tuple[slice, Array, Array]]:
    """Rows of the residual (first) and its references: shifted; and shifted, signs drawn, without its slow part."""
    size, blocks = one.residual.size, one.series.blocks
    quick = _without_slow(one)
    lengths = [block.stop - block.start for block in blocks]
    many = together(size)
    for first in range(0, 1 + shifts, many):
        rows = slice(first, min(first + many, 1 + shifts))
        count = rows.stop - rows.start
        shifted, flipped = np.empty((count, size)), np.empty((count, size))
        for k in range(count):
            still = first + k == 0
            by = 0 if still else int(rng.integers(size))
            signs = np.ones(len(blocks)) if still else rng.choice((-1.0, 1.0), len(blocks))
            shifted[k] = np.roll(one.residual, by)
            flipped[k] = np.roll(quick * np.repeat(signs, lengths), by)
        yield rows, shifted, flipped


def _without_slow(one: Told) -> Array:
    """A residual less the line through the means of its blocks."""
    counts = one.series.counts
    means, middles = [], []
    for block in one.series.blocks:
        n = int(np.count_nonzero(counts[block]))
        if n:
            means.append(float(one.residual[block].sum()) / n)
            middles.append(0.5 * (block.start + block.stop - 1))
    slow = np.interp(np.arange(one.residual.size), middles, means)
    result: Array = np.where(counts, one.residual - slow, 0.0)
    return result


@numba.njit(cache=True)
def _cell_sums(rows: Array, index: Index, cells: int) -> Array:
    out = np.zeros((rows.shape[0], cells))
    for k in range(rows.shape[0]):
        for n in range(rows.shape[1]):
            out[k, index[n]] += rows[k, n]
    return out


def _axes(told: Sequence[Told]) -> list[_Axis]:
    turns = [coordinates.reversals(one.series.command_V) for one in told]
    of = {
        "voltage_V": [one.series.command_V for one in told],
        "rate_V_per_s": [np.abs(coordinates.rate(one.series.command_V, one.series.dt_s)) for one in told],
        "force_N": [one.modelled_N for one in told],
        "amplitude_V": [distance for _, distance in turns],
    }
    axes = []
    for name, values in of.items():
        edges = distinct(coordinates.quantile_edges(np.concatenate(values), DRIVE_CELLS, TAIL))
        index = [
            2 * coordinates.cell_of(one, edges) + (direction > 0.0)
            for one, (direction, _) in zip(values, turns, strict=True)
        ]
        axes.append(_Axis(name, edges, index))
    return axes


def _counts(told: Sequence[Told], axis: _Axis) -> Array:
    n = np.zeros(2 * axis.count)
    for one, index in zip(told, axis.index, strict=True):
        n += np.bincount(index, weights=one.series.counts.astype(np.float64), minlength=n.size)
    return n


def _axis_cells(axis: _Axis, sums: Array, counts: Array) -> Cells:
    falling, rising = sums[:, :, ::2], sums[:, :, 1::2]
    score = np.maximum(standard(rising + falling).max(axis=0), standard(rising - falling).max(axis=0))
    energy = beyond(sums[0] ** 2 / np.maximum(counts, 1.0))
    return Cells(
        axis.name, axis.edges[:-1], axis.edges[1:], score, energy[::2] + energy[1::2], np.zeros(axis.count, np.int64)
    )


def _direction_cells(sums: Array, counts: Array) -> Cells:
    both = np.stack((sums[:, :, ::2].sum(axis=2), sums[:, :, 1::2].sum(axis=2)), axis=2)
    n = np.array([counts[::2].sum(), counts[1::2].sum()])
    energy = beyond(both[0] ** 2 / np.maximum(n, 1.0)).sum()
    score = standard(both[:, :, 1:] - both[:, :, :1]).max(axis=0)
    return Cells("direction", np.array([-1.0]), np.array([1.0]), score, np.array([energy]), np.zeros(1, np.int64))


def _history_times(told: Sequence[Told]) -> Array:
    dt_s = min(one.series.dt_s for one in told)
    longest = max(one.series.duration_s for one in told)
    return coordinates.times(dt_s, longest, HISTORY_TIMES, SHORTEST_HISTORY, LONGEST_HISTORY)


@dataclass(frozen=True)
class _History:
    """What fades between two times of command, model and heating, less what voltage and rate tell by themselves."""

    columns: Array
    every: int
    lengths: Array

    @classmethod
    def of(cls, one: Told, times_s: Array, voltage: Index, rate: Index) -> "_History":
        dt_s, counts = one.series.dt_s, one.series.counts
        every = -(-one.residual.size // MOST_HISTORY_SAMPLES)
        heating = coordinates.rate(one.series.command_V, dt_s) ** 2
        parts = []
        for values in (one.series.command_V, one.modelled_N, heating):
            scaled = (values - values.mean()) / max(float(values.std()), 1e-12)
            low = coordinates.faded_columns(scaled, dt_s, times_s)
            bands = np.ascontiguousarray(low[:, :-1] - low[:, 1:])
            for _ in range(2):
                _remove_cell_means(bands, voltage, counts)
                _remove_cell_means(bands, rate, counts)
            parts.append(_thinned(bands.T, every))
        columns = np.ascontiguousarray(np.vstack(parts).T)
        return cls(columns, every, every * np.sum(columns**2, axis=0))

    def products(self, rows: Array) -> Array:
        return self.every * _thinned(rows, self.every) @ self.columns


def _thinned(rows: Array, every: int) -> Array:
    """Means of so many samples each, shape (..., N // every)."""
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
    score = standard(products).max(axis=0).reshape(products.shape[1], 3, -1).max(axis=1)
    energy = beyond(products[0] ** 2 / np.maximum(lengths, 1e-9)).reshape(3, -1).max(axis=0)
    return Cells("history_s", times_s[:-1], times_s[1:], score, energy, np.zeros(times_s.size - 1, np.int64))


def _band_edges(told: Sequence[Told]) -> Array:
    highest = max(0.5 / one.series.dt_s for one in told)
    lowest = 8.0 / max(one.series.duration_s for one in told)
    count = max(int(np.ceil(BANDS_PER_DECADE * np.log10(highest / lowest))), 1)
    return np.geomspace(lowest, highest, count + 1)


@dataclass(frozen=True)
class _Coherence:
    """The model's spectrum, cut into bands."""

    spectrum: NDArray[np.complex128]
    band: Index
    bands: int
    drive: Array

    @classmethod
    def of(cls, one: Told, edges_Hz: Array) -> "_Coherence":
        spectrum = np.fft.rfft(colour.tapered(one.modelled_N))
        frequency_Hz = np.fft.rfftfreq(one.modelled_N.size, one.series.dt_s)
        band = np.searchsorted(edges_Hz, frequency_Hz, side="right")
        drive = np.bincount(band, weights=np.abs(spectrum) ** 2, minlength=edges_Hz.size + 1)
        return cls(spectrum.conj(), band, edges_Hz.size - 1, drive[1 : edges_Hz.size] * 2.0 / one.modelled_N.size)

    def products(self, rows: Array) -> NDArray[np.complex128]:
        """Cross-spectrum with the model in every band."""
        out = np.zeros((rows.shape[0], self.bands), complex)
        starts = np.searchsorted(self.band, np.arange(1, self.bands + 2))
        for k in range(rows.shape[0]):
            across = np.fft.rfft(rows[k]) * self.spectrum
            total = np.concatenate(([0.0], np.cumsum(across)))
            out[k] = (total[starts[1:]] - total[starts[:-1]]) * 2.0 / rows.shape[1]
        return out


def _band_cells(edges_Hz: Array, across: NDArray[np.complex128], drive: Array) -> Cells:
    energy = np.abs(across) ** 2 / np.maximum(drive, 1e-300)
    score = standard(np.sqrt(energy)) * np.sign(energy - energy.mean(axis=0))
    return Cells(
        "frequency_Hz", edges_Hz[:-1], edges_Hz[1:], score, beyond(energy), np.zeros(edges_Hz.size - 1, np.int64)
    )
