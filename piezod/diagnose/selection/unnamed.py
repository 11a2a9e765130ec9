"""Fit of an unnamed law to what all effects leave: which drivers, which memories, and whether it predicts.

Every pair of drivers is fitted with a bank of first-order lags by least squares with a ridge, and compared on blocks
that were left out of the fit. A law is taken only if it predicts these blocks much better, and almost all of them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.selection.formula import Formula, candidates
from piezod.diagnose.selection.significance import by_signs
from piezod.model.unnamed_law import (
    COMMAND,
    DIRECTION,
    DRIVERS,
    READING,
    WAY,
    Axis,
    Driver,
    UnnamedLaw,
    driver_tracks,
    lagged,
    positions,
)

Array = NDArray[np.float64]

Form = tuple[tuple[Driver, ...], bool]
"""Drivers of a law, and whether it is a gain."""

ROWS = 6000  # of a recording that are compared, as means of as many samples,
MOST_ROWS = 30_000  # and for the law that is taken
AS_WELL = 1.1  # times the error: a law that holds in the recordings of the identification too is preferred up to it
NODES = {"direction": 2, "way": 8, "stroke": 6}
USUAL_NODES = 9  # of the other drivers
PAIRS: tuple[tuple[Driver, ...], ...] = (
    *((name,) for name in DRIVERS if name != "stroke"),
    ("command", "direction"),
    ("command", "rate"),
    ("command", "way"),
    ("command", "stroke"),
    ("way", "direction"),
    ("rate", "direction"),
    ("reading", "reading_rate"),
    ("reading", "direction"),
    ("stroke", "direction"),
)
GAINS: tuple[tuple[Driver, ...], ...] = (("rate",), ("stroke",))
"""Drivers of a law that is a gain of the reading's stroke: how fast and how far it was driven."""
MEMORIES = 5  # at log-spaced times, from the shortest that the rows show to a sixth of the recording
LONGEST, SHORTEST = 1.0 / 6.0, 1e-4  # of the recording
FOLDS = 4  # of each recording, contiguous: what lies between two near blocks is no prediction
RIDGES = (1e-4, 1e-2, 1.0)  # of the mean diagonal
FINALISTS = 4  # pairs that are tried with all memories
PLAINER = 0.98  # of the best gain: a law with fewer numbers that reaches it is taken
LEAST = 0.1  # of what is left that is more than noise: a law must close so much of it
SURE = 0.01  # largest p-value, over all candidates
DEAD = 0.005  # of the command's range: smaller reversals are noise
SMOOTH = 3.0  # samples over which a rate is smoothed
SAME = 1e-9  # of the values: what spans less stands still
LARGE = 99.5  # percentile of a rate that is the last node


@dataclass(frozen=True)
class Fit:
    """An unnamed law and what it is worth.

    Parameters
    ----------
    law
        Drivers, memories and tables.
    before, after
        Root mean square error on blocks left out, without it and with it, of the recordings asked about [output unit].
    p
        Probability that a useless law gains as much, over all candidates.
    memories_s
        Shortest and longest memory that matters [s]; empty: none does.
    already
        Whether it holds in the recordings of the identification too.
    formula
        A short formula that predicts as well; None: the library has none.
    """

    law: UnnamedLaw
    before: float
    after: float
    p: float
    memories_s: tuple[float, ...]
    already: bool
    formula: Formula | None


@dataclass(frozen=True)
class _Record:
    """A recording as it is compared: means over boxes of samples."""

    asked: bool
    box_s: float
    residual: Array
    drivers: Array
    lift: Array
    counts: Array
    block: NDArray[np.int64]
    noise: float


@dataclass(frozen=True)
class _Candidate:
    drivers: tuple[Driver, ...]
    gain: bool
    memories_s: tuple[float, ...]
    errors: Array
    tables: Array

    @property
    def error(self) -> float:
        """Squared error of the recordings asked about, in units of the noise."""
        return float(self.errors.sum())


def fit_unnamed(series: Sequence[Series], modelled: Sequence[Array], floor: float) -> Fit | None:
    """Fit an unnamed law, if one predicts.

    Parameters
    ----------
    series
        Recordings.
    modelled
        Readings of the model that is written, for each recording, shape (N,) [output unit].
    floor
        Noise [output unit].
    """
    asked = [k for k, one in enumerate(series) if one.role == "recording"]
    dead_band = DEAD * max(float(np.ptp(one.command_V)) for one in series)
    smoothing_s = SMOOTH * max(one.dt_s for one in series)

    def records(chosen: Sequence[int], rows: int) -> list[_Record]:
        return [_record(series[k], modelled[k], dead_band, smoothing_s, rows) for k in chosen]

    few, everything = records(asked, ROWS), records(range(len(series)), ROWS)
    axes = {one.driver: one for one in _axes(everything)}
    bank = _bank(few)
    reference = _offsets_only(few)

    def tried(given: list[_Record], form: Form, memories_s: tuple[float, ...]) -> _Candidate:
        drivers, gain = form
        return _fitted(given, [axes[name] for name in drivers], memories_s, gain=gain)

    banks = (0.0,), (0.0, bank[0], bank[2]), (0.0, *bank)
    forms = [*((pair, False) for pair in PAIRS), *((drivers, True) for drivers in GAINS)]
    first = each(lambda one: tried(few, *one), [(form, memories) for form in forms for memories in banks[:2]])
    ahead = list(dict.fromkeys((one.drivers, one.gain) for one in sorted(first, key=lambda one: one.error)))[:FINALISTS]
    since = first + each(lambda form: tried(few, form, banks[2]), ahead)
    always = each(lambda one: tried(everything, *one), [(form, memories) for form in ahead for memories in banks])
    now, then = (_plainest(one, float(reference.sum())) for one in (since, always))
    chosen, given = (then, range(len(series))) if then.error < AS_WELL * now.error else (now, asked)
    best = tried(records(given, MOST_ROWS), (chosen.drivers, chosen.gain), chosen.memories_s)
    fine = records(asked, MOST_ROWS)
    reference = _offsets_only(fine)
    p = min(1.0, (len(since) + len(always)) * by_signs(np.log(reference / best.errors)))
    before, after = _errors(fine, reference, best.errors, [series[k] for k in asked], [modelled[k] for k in asked])
    if p > SURE or before**2 - after**2 < LEAST * max(before**2 - floor**2, 0.0):
        return None
    tare = 0.0 if best.gain else _mean(fine, axes, best)
    tables = best.tables - np.where(np.arange(best.tables.shape[0]) == 0, tare, 0.0)[:, None]
    law = UnnamedLaw(
        drivers=tuple(axes[name] for name in best.drivers),
        dead_band=dead_band,
        smoothing_s=smoothing_s,
        memories_s=best.memories_s,
        tables=tuple(tuple(float(value) for value in row) for row in tables),
        gain=best.gain,
    )
    short = _formula(records(given, ROWS), axes, best, bank)
    return Fit(law, before, after, p, _memories_that_matter(best), chosen is then, short)


def _record(series: Series, modelled: Array, dead_band: float, smoothing_s: float, most_rows: int) -> _Record:
    box = max(1, series.time_s.size // most_rows)
    rows = series.time_s.size // box
    tracks = driver_tracks(series.command_V, modelled, dead_band, smoothing_s, series.dt_s)
    counts = series.counts[: rows * box].reshape(rows, box)
    error = np.where(counts, (series.reading_N - modelled)[: rows * box].reshape(rows, box), 0.0)
    number = counts.sum(axis=1)
    block = np.zeros(series.time_s.size, dtype=np.int64)
    for k, one in enumerate(series.blocks):
        block[one] = k
    return _Record(
        series.role == "recording",
        box * series.dt_s,
        error.sum(axis=1) / np.maximum(number, 1),
        tracks[box // 2 :: box][:rows],
        (modelled - modelled[0])[box // 2 :: box][:rows],
        number.astype(np.float64),
        block[: rows * box : box],
        series.noise_N,
    )


def _axes(records: Sequence[_Record]) -> list[Axis]:
    """Range of every driver over all recordings."""
    drivers = np.concatenate([one.drivers for one in records])
    axes = []
    for k, name in enumerate(DRIVERS):
        low, high = float(drivers[:, k].min()), float(drivers[:, k].max())
        if k not in (COMMAND, READING):
            high = float(np.percentile(np.abs(drivers[:, k]), LARGE))
            low = 0.0 if k >= WAY else -high
        if k == DIRECTION:
            low, high = -1.0, 1.0
        wider = max(high, low + SAME * max(abs(low), abs(high), SAME))  # of a driver that stands still
        axes.append(Axis(driver=name, low=low, high=wider, nodes=NODES.get(name, USUAL_NODES)))
    return axes


def _bank(records: Sequence[_Record]) -> tuple[float, ...]:
    longest_s = max(one.box_s * one.residual.size for one in records)
    shortest_s = max(4.0 * max(one.box_s for one in records), SHORTEST * longest_s)
    return tuple(float(one) for one in np.geomspace(shortest_s, max(LONGEST * longest_s, 2.0 * shortest_s), MEMORIES))


def _offsets_only(records: Sequence[_Record]) -> Array:
    """Squared error of every block in units of the noise, the offset of each recording fitted alone."""
    return np.concatenate([_by_block(one, _centred(one)) for one in records])


def _centred(record: _Record) -> Array:
    """The residual without its mean."""
    mean: Array = record.residual - float(record.residual @ record.counts) / float(record.counts.sum())
    return mean


def _by_block(record: _Record, residual: Array) -> Array:
    weighted = record.counts * (residual / record.noise) ** 2
    return np.maximum(np.bincount(record.block, weighted), 1e-300)


def _columns(record: _Record, axes: Sequence[Axis], memories_s: Sequence[float]) -> Array:
    """Nodes' weights behind every lag, shape (rows, M nodes)."""
    grid = np.ones((record.residual.size, 1))
    for axis in axes:
        place = positions(axis, record.drivers[:, DRIVERS.index(axis.driver)]) * (axis.nodes - 1)
        first = np.minimum(place.astype(int), axis.nodes - 2)
        hats = np.zeros((place.size, axis.nodes))
        hats[np.arange(place.size), first] = 1.0 - (place - first)
        hats[np.arange(place.size), first + 1] = place - first
        grid = (grid[:, :, None] * hats[:, None, :]).reshape(place.size, -1)
    keeps = [math.exp(-record.box_s / memory_s) if memory_s > 0.0 else 0.0 for memory_s in memories_s]
    return np.hstack([lagged(grid, keep) if keep else grid for keep in keeps])


def _fitted(
    records: Sequence[_Record], axes: Sequence[Axis], memories_s: tuple[float, ...], *, gain: bool
) -> _Candidate:
    """Tables by least squares with the ridge that predicts best."""

    def shaped(record: _Record) -> Array:
        return _columns(record, axes, memories_s) * (record.lift[:, None] if gain else 1.0)

    errors, found = _predicted(records, shaped)
    return _Candidate(tuple(axis.driver for axis in axes), gain, memories_s, errors, found.reshape(len(memories_s), -1))


def _formula(
    records: Sequence[_Record], axes: Mapping[Driver, Axis], law: _Candidate, bank: tuple[float, ...]
) -> Formula | None:
    """The best formula, where it gains nearly as much as a law of one driver, with its direction or without."""
    named: list[Driver] = [name for name in law.drivers if name != "direction"]
    if len(named) != 1:
        return None
    driver = named[0]
    directed = len(law.drivers) > 1
    reference = float(np.concatenate([_by_block(one, _centred(one)) for one in records if one.asked]).sum())
    gains: list[tuple[float, Formula]] = []
    for one in candidates(driver, axes[driver].high, (0.0, *bank), directed=directed):

        def shaped(record: _Record, one: Formula = one) -> Array:
            values = one.values(record.drivers[:, DRIVERS.index(driver)], record.drivers[:, DIRECTION])
            column = values[:, None] * (record.lift[:, None] if law.gain else 1.0)
            return lagged(column, math.exp(-record.box_s / one.memory_s)) if one.memory_s > 0.0 else column

        errors, found = _predicted(records, shaped)
        gains.append((reference - float(errors.sum()), replace(one, factor=float(found[0]))))
    tables = _fitted(records, [axes[name] for name in law.drivers], law.memories_s, gain=law.gain)
    gained, best = max(gains, key=lambda one: one[0])
    return best if gained >= PLAINER * (reference - tables.error) else None


def _predicted(records: Sequence[_Record], shaped: Callable[[_Record], Array]) -> tuple[Array, Array]:
    """Squared error of every block asked about, left out of the fit, and the coefficients of all; the best ridge.

    `shaped` gives the columns of a recording, shape (rows, K).
    """
    grams, sides, squares = [], [], []
    asked = np.concatenate([np.full(int(one.block[-1]) + 1, one.asked) for one in records])
    folds = np.concatenate([np.arange(n := int(one.block[-1]) + 1) * FOLDS // n for one in records])
    for number, record in enumerate(records):
        columns = np.hstack([shaped(record), np.zeros((record.residual.size, len(records)))])
        columns[:, number - len(records)] = 1.0
        weights = np.sqrt(record.counts) / record.noise
        columns *= weights[:, None]
        side = weights * record.residual
        for k in range(int(record.block[-1]) + 1):
            rows = record.block == k
            grams.append(columns[rows].T @ columns[rows])
            sides.append(columns[rows].T @ side[rows])
            squares.append(float(side[rows] @ side[rows]))
    gram, side = np.sum(grams, axis=0), np.sum(sides, axis=0)
    size = side.size - len(records)
    diagonal = float(np.trace(gram[:size, :size])) / size
    ridge = np.full(side.size, diagonal if diagonal > 0.0 else 1.0)  # nothing moves: every table is zero
    ridge[size:] *= 1e-9
    best: tuple[float, Array, Array] | None = None
    for strength in RIDGES:
        errors = np.empty(len(squares))
        for fold in range(FOLDS):
            left_out = np.flatnonzero(folds == fold)
            less = gram - sum(grams[k] for k in left_out) + np.diag(strength * ridge)
            found = np.linalg.solve(less, side - sum(sides[k] for k in left_out))
            for k in left_out.tolist():
                errors[k] = squares[k] - 2.0 * found @ sides[k] + found @ grams[k] @ found
        if best is None or errors[asked].sum() < best[0]:
            found = np.linalg.solve(gram + np.diag(strength * ridge), side)
            best = float(errors[asked].sum()), np.maximum(errors[asked], 1e-300), found[:size]
    assert best is not None
    return best[1], best[2]


def _plainest(tried: Sequence[_Candidate], reference: float) -> _Candidate:
    """The one with the fewest numbers of those that gain nearly as much as the best."""
    gains = [reference - one.error for one in tried]
    near = [one for one, gain in zip(tried, gains, strict=True) if gain >= PLAINER * max(gains)]
    return min(near, key=lambda one: one.tables.size) if near else tried[0]


def _errors(
    records: Sequence[_Record], reference: Array, errors: Array, series: Sequence[Series], modelled: Sequence[Array]
) -> tuple[float, float]:
    """Root mean square error of the recordings asked about, without a law and with it on blocks left out."""
    total = samples = fell = 0.0
    first = 0
    for record, one, model in zip(records, series, modelled, strict=True):
        blocks = int(record.block[-1]) + 1
        error = (one.reading_N - model)[one.counts]
        total += float(error.size * np.var(error))
        samples += error.size
        fell += record.noise**2 * float(np.sum((reference - errors)[first : first + blocks]))
        first += blocks
    before = total / max(samples, 1.0)
    return float(np.sqrt(before)), float(np.sqrt(max(before - fell / max(samples, 1.0), 0.0)))


def _mean(records: Sequence[_Record], axes: Mapping[Driver, Axis], law: _Candidate) -> float:
    """What a law adds on average: a tare, and no part of it."""
    total = 0.0
    for one in records:
        columns = _columns(one, [axes[name] for name in law.drivers], law.memories_s)
        total += float(one.counts @ (columns @ law.tables.ravel()))
    return total / sum(float(one.counts.sum()) for one in records)


def _memories_that_matter(best: _Candidate) -> tuple[float, ...]:
    """Shortest and longest lag whose table changes the reading by a tenth of what the largest one does."""
    sizes = np.std(best.tables, axis=1)
    behind = [memory_s for memory_s, size in zip(best.memories_s, sizes, strict=True) if size > 0.1 * sizes.max()]
    lags = [memory_s for memory_s in behind if memory_s > 0.0]
    return (min(lags), max(lags)) if lags else ()
