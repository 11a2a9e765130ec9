"""Where a residual is: at which voltages, rates, forces, times, frequencies and pasts it is more than its own noise.

Every axis is cut into cells, every cell has a score, and one max-T over all cells of all axes, stepped down (Westfall
and Young 1993), keeps the chance of one false place at 5 %. The scores are compared with what the same residual gives
where nothing can be there:

- cells of the drive, and coherence with the model: the residual shifted circularly by a random time within each
  recording (a slow part cannot then pass for a function of the voltage), and also shifted with the sign of each block
  drawn and its slow part taken away (the shift of a periodic residual over a periodic drive says nothing by itself);
- cells of time, and of temperature, whose spread no shift changes: independent cells as uneven as neighbours are;
- lines, whose power no shift changes either: Gaussian noise with the spectrum of the line's surroundings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.diagnose import colour, coordinates
from piezod.diagnose.series import Series

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

LEVEL = 0.05
DRIVE_CELLS = 24
FEWEST_TIME_CELLS, TIME_CELLS, FINE_CELLS = 12, 48, 480
MEMORIES = 12.0  # that a cell of time is long at least
BANDS_PER_DECADE = 6
LINE_BANDS = 200
HISTORY_TIMES = 12
TEMPERATURE_CELLS = 12
SHORTEST_HISTORY, LONGEST_HISTORY = 8.0, 0.3  # samples; part of the duration
MOST_HISTORY_SAMPLES = 65_536
TOGETHER = 20  # references that are worked on at once
LEAST_SHARE = 0.005  # of the unexplained energy, below which a place is not told
LEAST_EXCESS = 0.02  # of a residual's power, below which shares are not measured against less


@dataclass(frozen=True)
class Place:
    """A part of an axis in which a residual is more than noise.

    Parameters
    ----------
    axis
        time_s, frequency_Hz, voltage_V, rate_V_per_s, force_N, amplitude_V (distance from the last reversal),
        history_s (fading times), temperature_C or direction.
    low, high
        Its range; equal for a line.
    share
        Part of the unexplained energy in it, 0 to 1; places on different axes may hold the same energy.
    p
        Family-wise.
    """

    axis: str
    low: float
    high: float
    share: float
    p: float


@dataclass(frozen=True)
class Told:
    """A recording's residual in units of its noise, about 0, and 0 where it does not count."""

    series: Series
    residual: Array
    modelled_N: Array

    @classmethod
    def of(cls, series: Series, residual_N: Array, modelled_N: Array) -> "Told":
        """From a residual in newtons."""
        known = series.counts & np.isfinite(residual_N)
        mean = residual_N[known].mean() if known.any() else 0.0
        return cls(series, np.where(known, residual_N - mean, 0.0) / series.noise_N, modelled_N)


@dataclass(frozen=True)
class Cells:
    """Cells of an axis.

    Parameters
    ----------
    axis
        Of a place.
    low, high
        Range of every cell, shape (C,).
    score
        Of the residual and of every reference, shape (1 + shifts, C).
    energy
        Of every cell beyond the reference, in units of the noise, shape (C,).
    kin
        Neighbours of the same kin are one place, shape (C,).
    """

    axis: str
    low: Array
    high: Array
    score: Array
    energy: Array
    kin: Index


def locate(
    series: Sequence[Series],
    residuals: Sequence[Array],
    modelled: Sequence[Array],
    *,
    shifts: int = 99,
    seed: int = 0,
) -> list[Place]:
    """Find where residuals are more than noise.

    Parameters
    ----------
    series
        Only those with the role "recording" are looked at; times are in each recording's own time.
    residuals
        Reading less simulation, each shape (N,) [N].
    modelled
        Simulation, each shape (N,) [N].
    shifts
        How many references; the smallest p is 1 / (1 + shifts).
    seed
        Of the references.

    Returns
    -------
    list of Place
        The largest share first; empty when nothing is there.
    """
    told = [
        Told.of(one, residual, model)
        for one, residual, model in zip(series, residuals, modelled, strict=True)
        if one.role == "recording" and one.counts.any()
    ]
    if not told or not any(one.residual.any() for one in told):
        return []
    rng = np.random.default_rng(seed)
    cells = [*_of_drive(told, shifts, rng), *_of_time(told, shifts, rng), *_of_lines(told, shifts, rng)]
    total = sum(float(one.residual @ one.residual) for one in told)
    noise = sum(float(np.count_nonzero(one.series.counts)) for one in told)
    return _places(cells, max(total - noise, LEAST_EXCESS * total))


# ---------------------------------------------------------------------------------------------------- decision


def _places(cells: Sequence[Cells], unexplained: float) -> list[Place]:
    p_values = _stepped_down(cells)
    places = []
    for one, p in zip(cells, p_values, strict=True):
        for run in _runs(p <= LEVEL, one.kin):
            share = float(np.clip(one.energy[run].sum() / unexplained, 0.0, 1.0))
            if share < LEAST_SHARE:
                continue
            places.append(
                Place(one.axis, float(one.low[run].min()), float(one.high[run].max()), share, float(p[run].min()))
            )
    return sorted(_without_repeats(places), key=lambda place: -place.share)


def _stepped_down(cells: Sequence[Cells]) -> list[Array]:
    """Family-wise p of every cell, each axis on the scale of its own largest reference."""
    scaled = []
    for one in cells:
        largest = one.score[1:].max(axis=1)
        scaled.append((one.score - largest.mean()) / max(float(largest.std()), 1e-12))
    score = np.hstack(scaled)
    order = np.argsort(score[0])
    beyond = np.maximum.accumulate(score[1:, order], axis=1) >= score[0, order]
    p = (1.0 + beyond.sum(axis=0)) / score.shape[0]
    p = np.maximum.accumulate(p[::-1])[::-1]
    result = np.empty_like(p)
    result[order] = p
    return np.split(result, np.cumsum([one.low.size for one in cells])[:-1])


def _runs(hit: Mask, kin: Index) -> Iterator[Index]:
    """Stretches of neighbouring cells of the same kin that are hit."""
    places = np.flatnonzero(hit)
    if places.size:
        breaks = np.flatnonzero((np.diff(places) > 1) | (np.diff(kin[places]) != 0)) + 1
        yield from np.split(places, breaks)


def _without_repeats(places: Sequence[Place]) -> list[Place]:
    """The same without a place that lies in a larger one of the same axis with more in it."""
    kept: list[Place] = []
    for place in sorted(places, key=lambda one: (-one.share, one.low - one.high)):
        if not any(one.axis == place.axis and one.low <= place.low and place.high <= one.high for one in kept):
            kept.append(place)
    return kept


# ------------------------------------------------------------------------------------------- cells of the drive


@dataclass(frozen=True)
class _Axis:
    """A coordinate of the drive: its edges, and every sample's cell and direction (2 cell + rising)."""

    name: str
    edges: Array
    index: list[Index]

    @property
    def count(self) -> int:
        return max(self.edges.size - 1, 1)


def _of_drive(told: Sequence[Told], shifts: int, rng: np.random.Generator) -> list[Cells]:
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
    for first in range(0, 1 + shifts, TOGETHER):
        rows = slice(first, min(first + TOGETHER, 1 + shifts))
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
        edges = _distinct(coordinates.quantile_edges(np.concatenate(values), DRIVE_CELLS))
        index = [
            2 * coordinates.cell_of(one, edges) + (direction > 0.0)
            for one, (direction, _) in zip(values, turns, strict=True)
        ]
        axes.append(_Axis(name, edges, index))
    return axes


def _distinct(edges: Array) -> Array:
    """Edges without those that differ by rounding only."""
    least = 1e-6 * max(float(np.ptp(edges)), 1e-300)
    kept = [float(edges[0])]
    for edge in edges[1:]:
        if edge - kept[-1] > least:
            kept.append(float(edge))
    return np.array(kept if len(kept) > 1 else [kept[0], float(edges[-1])])


def _counts(told: Sequence[Told], axis: _Axis) -> Array:
    n = np.zeros(2 * axis.count)
    for one, index in zip(told, axis.index, strict=True):
        n += np.bincount(index, weights=one.series.counts.astype(np.float64), minlength=n.size)
    return n


def _axis_cells(axis: _Axis, sums: Array, counts: Array) -> Cells:
    falling, rising = sums[:, :, ::2], sums[:, :, 1::2]
    score = np.maximum(_standard(rising + falling).max(axis=0), _standard(rising - falling).max(axis=0))
    energy = _beyond(sums[0] ** 2 / np.maximum(counts, 1.0))
    return Cells(
        axis.name, axis.edges[:-1], axis.edges[1:], score, energy[::2] + energy[1::2], np.zeros(axis.count, np.int64)
    )


def _direction_cells(sums: Array, counts: Array) -> Cells:
    both = np.stack((sums[:, :, ::2].sum(axis=2), sums[:, :, 1::2].sum(axis=2)), axis=2)
    n = np.array([counts[::2].sum(), counts[1::2].sum()])
    energy = _beyond(both[0] ** 2 / np.maximum(n, 1.0)).sum()
    score = _standard(both[:, :, 1:] - both[:, :, :1]).max(axis=0)
    return Cells("direction", np.array([-1.0]), np.array([1.0]), score, np.array([energy]), np.zeros(1, np.int64))


def _standard(values: Array) -> Array:
    """How far from 0 in standard deviations over the references and the residual, shape (..., 1 + shifts, C)."""
    centred = values - values.mean(axis=-2, keepdims=True)
    result: Array = np.abs(centred) / np.maximum(centred.std(axis=-2, keepdims=True), 1e-12)
    return result


def _beyond(energy: Array) -> Array:
    """Energy of the residual less the references' mean, not below 0, shape (C,)."""
    result: Array = np.maximum(energy[0] - energy[1:].mean(axis=0), 0.0)
    return result


# ------------------------------------------------------------------------------------------------------ history


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
    score = _standard(products).max(axis=0).reshape(products.shape[1], 3, -1).max(axis=1)
    energy = _beyond(products[0] ** 2 / np.maximum(lengths, 1e-9)).reshape(3, -1).max(axis=0)
    return Cells("history_s", times_s[:-1], times_s[1:], score, energy, np.zeros(times_s.size - 1, np.int64))


# ---------------------------------------------------------------------------------------------------- frequency


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
    score = _standard(np.sqrt(energy)) * np.sign(energy - energy.mean(axis=0))
    return Cells(
        "frequency_Hz", edges_Hz[:-1], edges_Hz[1:], score, _beyond(energy), np.zeros(edges_Hz.size - 1, np.int64)
    )


def _of_lines(told: Sequence[Told], shifts: int, rng: np.random.Generator) -> list[Cells]:
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
    for first in range(1, 1 + shifts, TOGETHER):
        count = min(TOGETHER, 1 + shifts - first)
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
    if over < 12.0:
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


# --------------------------------------------------------------------------------------- time and temperature


def _of_time(told: Sequence[Told], shifts: int, rng: np.random.Generator) -> list[Cells]:
    cells, means, temperatures, raw = [], [], [], []
    for one in told:
        memory = colour.memory(one.residual)
        cells_of_time = int(np.clip(one.residual.size / (MEMORIES * memory), FEWEST_TIME_CELLS, TIME_CELLS))
        coarse = _Stretches.of(one, one.residual, cells_of_time)
        level = np.vstack((coarse.mean, rng.standard_normal((shifts, coarse.mean.size))))
        level = _uneven(level)
        cells.append(_level_cells(one, coarse, level))
        cells.append(_power_cells(one, coarse, memory, shifts, rng))
        fine = _Stretches.of(one, colour.innovations(one.residual), FINE_CELLS)
        cells.append(_power_cells(one, fine, 1.0, shifts, rng))
        if one.series.temperature_C is not None:
            means.append(level)
            raw.append(np.vstack((coarse.n, coarse.n * (coarse.mean - np.median(coarse.mean)))).T)
            temperatures.append(_Stretches.of(one, one.series.temperature_C, cells_of_time).mean)
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


def _power_cells(one: Told, stretches: _Stretches, memory: float, shifts: int, rng: np.random.Generator) -> Cells:
    """Cells with more power than others; a cube root makes mean squares nearly Gaussian (Wilson, Hilferty 1931)."""
    low, high = stretches.times_s(one)
    degrees = max(float(np.diff(stretches.edges).mean()) / memory, 1.0)
    reference = rng.chisquare(degrees, (shifts, low.size)) / degrees
    score = _uneven(np.cbrt(np.vstack((stretches.power / max(float(np.median(stretches.power)), 1e-300), reference))))
    energy = stretches.n * np.maximum(stretches.power - np.median(stretches.power), 0.0)
    return Cells("time_s", low, high, score, energy, np.zeros(low.size, np.int64))


def _temperature_cells(level: Array, temperature_C: Array, raw: Array) -> Cells:
    """Cells of temperature, from cells of time: their scores, temperatures, and readings and sums in them."""
    edges = _distinct(coordinates.quantile_edges(temperature_C, TEMPERATURE_CELLS))
    index = coordinates.cell_of(temperature_C, edges)
    cells = edges.size - 1
    many = np.sqrt(np.maximum(np.bincount(index, minlength=cells), 1.0))
    score = np.abs(np.stack([np.bincount(index, weights=row, minlength=cells) for row in level])) / many
    n, sums = (np.bincount(index, weights=column, minlength=cells) for column in raw.T)
    energy = sums**2 / np.maximum(n, 1.0)
    return Cells("temperature_C", edges[:-1], edges[1:], score, energy, (sums > 0.0).astype(np.int64))
