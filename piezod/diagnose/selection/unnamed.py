"""Fit of an unnamed law to the residual of all effects: choice of drivers and memories, and test of its prediction.

Every pair of drivers is fitted with a bank of first-order lags by ridge regression, and compared on left-out blocks. A
law is accepted only if it predicts these blocks much better.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.hypothesis.left_out import sign_test_p
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.selection.formula import Formula, candidates
from piezod.estimation.fit.blocks import Blocks, contiguous_folds
from piezod.estimation.recordings.series import Series
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

Form = tuple[tuple[Driver, ...], bool]  # drivers of a law, and whether it is a gain
ROWS = 6000  # rows of a recording, each a mean over a box of samples
MOST_ROWS = 30_000  # rows for the fit of the chosen law
AS_WELL = 1.1  # largest error ratio at which a law that also holds in the identification recordings is preferred
NODES = {"direction": 2, "way": 8, "stroke": 6}
OTHER_NODES = 9  # nodes of the other drivers
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
"""Drivers of a law that is a gain of the reading's stroke: rate and length of the stroke."""
MEMORIES = 5  # log-spaced times from the shortest that the rows show to a sixth of the recording
LONGEST, SHORTEST = 1.0 / 6.0, 1e-4  # limits of the times, relative to the recording
RIDGES = (1e-4, 1e-2, 1.0)  # ridges, relative to the mean diagonal
BEST_FORMS = 4  # forms that are tried with all memories
SIMPLER = 0.98  # share of the best gain at which a law with fewer numbers is preferred
LEAST = 0.1  # least share of the excess over the noise that a law must explain
SIGNIFICANT = 0.01  # largest p-value, over all candidates
DEAD = 0.005  # dead band for reversals, relative to the range of the command
SMOOTH = 3.0  # smoothing of a rate [samples]
CONSTANT = 1e-9  # relative range below which a driver is constant
LARGE = 99.5  # percentile of a driver at its last node


@dataclass(frozen=True)
class FittedLaw:
    """Unnamed law with its errors.

    Parameters
    ----------
    law
        Drivers, memories and tables.
    before, after
        Rms error of left-out blocks of the diagnosed recordings, without and with the law [output unit].
    p
        Probability that a useless law gains as much, over all candidates.
    memories_s
        Shortest and longest relevant memory, or every lag of linear dynamics [s]; empty: none.
    already
        Whether it also holds in the identification recordings.
    formula
        Short formula that predicts as well; None: none.
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
    """Recording, averaged over boxes of samples.

    Parameters
    ----------
    diagnosed, box_s, noise
        Whether it is diagnosed, duration of a box [s], and noise of a sample [output unit].
    residual, stroke
        Mean residual, and reading minus the first reading, shape (rows,) [output unit].
    drivers
        Values of all drivers, shape (rows, drivers).
    counts, block
        Number of readings that count, and number of the block, shape (rows,).
    """

    diagnosed: bool
    box_s: float
    residual: Array
    drivers: Array
    stroke: Array
    counts: Array
    block: NDArray[np.int64]
    noise: float

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block[-1]) + 1

    @classmethod
    def of(cls, series: Series, modelled: Array, dead_band: float, smoothing_s: float, most_rows: int) -> "_Record":
        box = max(1, series.time_s.size // most_rows)
        rows = series.time_s.size // box
        tracks = driver_tracks(series.command_V, modelled, dead_band, smoothing_s, series.dt_s)
        counts = series.counts[: rows * box].reshape(rows, box)
        error = np.where(counts, (series.reading_N - modelled)[: rows * box].reshape(rows, box), 0.0)
        number = counts.sum(axis=1)
        block = np.zeros(series.time_s.size, dtype=np.int64)
        for k, samples in enumerate(series.blocks):
            block[samples] = k
        return cls(
            series.role == "recording",
            box * series.dt_s,
            error.sum(axis=1) / np.maximum(number, 1),
            tracks[box // 2 :: box][:rows],
            (modelled - modelled[0])[box // 2 :: box][:rows],
            number.astype(np.float64),
            block[: rows * box : box],
            series.noise_N,
        )


@dataclass(frozen=True)
class _Candidate:
    drivers: tuple[Driver, ...]
    gain: bool
    memories_s: tuple[float, ...]
    errors: Array
    tables: Array

    @property
    def error(self) -> float:
        """Squared error of the diagnosed recordings [noise variance]."""
        return float(self.errors.sum())


def fit_unnamed(series: Sequence[Series], modelled: Sequence[Array], floor: float) -> FittedLaw | None:
    """Fit an unnamed law; None if no law predicts the residual.

    `modelled`: readings of the written model, shape (N,) each; `floor`: noise; all in [output unit].
    """
    diagnosed = [k for k, s in enumerate(series) if s.role == "recording"]
    dead_band = DEAD * max(float(np.ptp(s.command_V)) for s in series)
    smoothing_s = SMOOTH * max(s.dt_s for s in series)

    def records(numbers: Sequence[int], rows: int) -> list[_Record]:
        return [_Record.of(series[k], modelled[k], dead_band, smoothing_s, rows) for k in numbers]

    few, everything = records(diagnosed, ROWS), records(range(len(series)), ROWS)
    axes = {axis.driver: axis for axis in _axes(everything)}
    bank = _bank(few)
    since, already = _candidates(few, everything, axes, bank)
    reference = float(_offsets_only(few).sum())
    chosen, best_already = _simplest(since, reference), _simplest(already, reference)
    holds_already = best_already.error < AS_WELL * chosen.error
    chosen = best_already if holds_already else chosen
    given = range(len(series)) if holds_already else diagnosed
    best = _fitted(
        records(given, MOST_ROWS), [axes[name] for name in chosen.drivers], chosen.memories_s, gain=chosen.gain
    )
    fine = records(diagnosed, MOST_ROWS)
    fine_reference = _offsets_only(fine)
    p = min(1.0, (len(since) + len(already)) * sign_test_p(np.log(fine_reference / best.errors)))
    before, after = _errors(
        fine, fine_reference, best.errors, [series[k] for k in diagnosed], [modelled[k] for k in diagnosed]
    )
    if p > SIGNIFICANT or before**2 - after**2 < LEAST * max(before**2 - floor**2, 0.0):
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
    formula = _formula(records(given, ROWS), axes, best, bank)
    return FittedLaw(law, before, after, p, _relevant_memories(best), holds_already, formula)


def _candidates(
    few: list[_Record], everything: list[_Record], axes: Mapping[Driver, Axis], bank: tuple[float, ...]
) -> tuple[list[_Candidate], list[_Candidate]]:
    """Laws fitted to the diagnosed recordings, and the best forms fitted to all recordings.

    All forms are tried without memory and with two lags, the best forms also with the whole bank.
    """

    def fitted(records: list[_Record], form: Form, memories_s: tuple[float, ...]) -> _Candidate:
        drivers, gain = form
        return _fitted(records, [axes[name] for name in drivers], memories_s, gain=gain)

    banks = (0.0,), (0.0, bank[0], bank[2]), (0.0, *bank)
    forms = [*((pair, False) for pair in PAIRS), *((drivers, True) for drivers in GAINS)]
    first = each(lambda pair: fitted(few, *pair), [(form, memories_s) for form in forms for memories_s in banks[:2]])
    ranked = dict.fromkeys((law.drivers, law.gain) for law in sorted(first, key=lambda law: law.error))
    best = list(ranked)[:BEST_FORMS]
    since = first + each(lambda form: fitted(few, form, banks[2]), best)
    already = each(
        lambda pair: fitted(everything, *pair), [(form, memories_s) for form in best for memories_s in banks]
    )
    return since, already


def _axes(records: Sequence[_Record]) -> list[Axis]:
    """Axis of every driver with its range over all recordings."""
    drivers = np.concatenate([record.drivers for record in records])
    axes = []
    for k, name in enumerate(DRIVERS):
        low, high = float(drivers[:, k].min()), float(drivers[:, k].max())
        if k not in (COMMAND, READING):
            high = float(np.percentile(np.abs(drivers[:, k]), LARGE))
            low = 0.0 if k >= WAY else -high
        if k == DIRECTION:
            low, high = -1.0, 1.0
        high = max(high, low + CONSTANT * max(abs(low), abs(high), CONSTANT))  # a constant driver too has a range
        axes.append(Axis(driver=name, low=low, high=high, nodes=NODES.get(name, OTHER_NODES)))
    return axes


def _bank(records: Sequence[_Record]) -> tuple[float, ...]:
    """Time constants of the bank of lags [s]."""
    longest_s = max(record.box_s * record.residual.size for record in records)
    shortest_s = max(4.0 * max(record.box_s for record in records), SHORTEST * longest_s)
    return tuple(
        float(time_s) for time_s in np.geomspace(shortest_s, max(LONGEST * longest_s, 2.0 * shortest_s), MEMORIES)
    )


def _offsets_only(records: Sequence[_Record]) -> Array:
    """Squared error of every block with only an offset of each recording fitted, shape (B,) [noise variance]."""
    sums = _sums(records, lambda record: np.empty((record.residual.size, 0)))
    return np.maximum(sums.errors(sums.solve()), 1e-300)


def _columns(record: _Record, axes: Sequence[Axis], memories_s: Sequence[float]) -> Array:
    """Weights of the nodes after every lag, shape (rows, lags * nodes)."""
    grid = np.ones((record.residual.size, 1))
    for axis in axes:
        place = positions(axis, record.drivers[:, DRIVERS.index(axis.driver)]) * (axis.nodes - 1)
        first = np.minimum(place.astype(int), axis.nodes - 2)
        hats = np.zeros((place.size, axis.nodes))
        hats[np.arange(place.size), first] = 1.0 - (place - first)
        hats[np.arange(place.size), first + 1] = place - first
        grid = (grid[:, :, None] * hats[:, None, :]).reshape(place.size, -1)
    return np.hstack([_lagged(grid, record.box_s, memory_s) for memory_s in memories_s])


def _lagged(columns: Array, box_s: float, memory_s: float) -> Array:
    """Columns after a first-order lag; unchanged for a memory of 0."""
    decay = math.exp(-box_s / memory_s) if memory_s > 0.0 else 0.0
    return lagged(columns, decay) if decay else columns


def _fitted(
    records: Sequence[_Record], axes: Sequence[Axis], memories_s: tuple[float, ...], *, gain: bool
) -> _Candidate:
    """Tables by ridge regression with the ridge that predicts best."""

    def shaped(record: _Record) -> Array:
        return _columns(record, axes, memories_s) * (record.stroke[:, None] if gain else 1.0)

    errors, coefficients = _predicted(records, shaped)
    tables = coefficients.reshape(len(memories_s), -1)
    return _Candidate(tuple(axis.driver for axis in axes), gain, memories_s, errors, tables)


def _formula(
    records: Sequence[_Record], axes: Mapping[Driver, Axis], law: _Candidate, bank: tuple[float, ...]
) -> Formula | None:
    """Best formula for a law of one driver (and direction), if it gains nearly as much as the tables; else None."""
    named: list[Driver] = [name for name in law.drivers if name != "direction"]
    if len(named) != 1:
        return None
    driver = named[0]
    directed = len(law.drivers) > 1
    reference = float(_offsets_only([record for record in records if record.diagnosed]).sum())
    gains: list[tuple[float, Formula]] = []
    for formula in candidates(driver, axes[driver].high, (0.0, *bank), directed=directed):

        def shaped(record: _Record, formula: Formula = formula) -> Array:
            values = formula.values(record.drivers[:, DRIVERS.index(driver)], record.drivers[:, DIRECTION])
            column = values[:, None] * (record.stroke[:, None] if law.gain else 1.0)
            return _lagged(column, record.box_s, formula.memory_s)

        errors, coefficients = _predicted(records, shaped)
        gains.append((reference - float(errors.sum()), replace(formula, factor=float(coefficients[0]))))
    tables = _fitted(records, [axes[name] for name in law.drivers], law.memories_s, gain=law.gain)
    gain, best = max(gains, key=lambda pair: pair[0])
    return best if gain >= SIMPLER * (reference - tables.error) else None


def _predicted(records: Sequence[_Record], shaped: Callable[[_Record], Array]) -> tuple[Array, Array]:
    """Squared errors of the left-out blocks of the diagnosed recordings, and coefficients from all blocks.

    The ridge with the least error is chosen. `shaped` computes the columns of a recording, shape (rows, K).
    """
    sums = _sums(records, shaped)
    diagnosed = np.concatenate([np.full(record.blocks, record.diagnosed) for record in records])
    folds = contiguous_folds([record.blocks for record in records])
    folded, (gram, side) = sums.folded(folds), sums.total
    size = side.size - len(records)
    diagonal = float(np.trace(gram[:size, :size])) / size
    ridge = np.full(side.size, diagonal if diagonal > 0.0 else 1.0)  # without motion every table is zero
    ridge[size:] *= 1e-9
    tried = [sums.errors(folded.without(np.diag(strength * ridge))[folds])[diagnosed] for strength in RIDGES]
    best = int(np.argmin([errors.sum() for errors in tried]))
    return np.maximum(tried[best], 1e-300), sums.solve(penalty=np.diag(RIDGES[best] * ridge))[:size]


def _sums(records: Sequence[_Record], shaped: Callable[[_Record], Array]) -> Blocks:
    """Sums of the columns of recordings and of an offset of each."""
    sums = []
    for number, record in enumerate(records):
        columns = np.hstack([shaped(record), np.zeros((record.residual.size, len(records)))])
        columns[:, number - len(records)] = 1.0
        weights = np.sqrt(record.counts) / record.noise
        members = [record.block == k for k in range(record.blocks)]
        sums.append(Blocks.of(columns * weights[:, None], weights * record.residual, members))
    return Blocks.all_of(sums)


def _simplest(tried: Sequence[_Candidate], reference: float) -> _Candidate:
    """Law with the fewest numbers among those that gain nearly as much as the best."""
    gains = [reference - law.error for law in tried]
    near = [law for law, gain in zip(tried, gains, strict=True) if gain >= SIMPLER * max(gains)]
    return min(near, key=lambda law: law.tables.size) if near else tried[0]


def _errors(
    records: Sequence[_Record], reference: Array, errors: Array, series: Sequence[Series], modelled: Sequence[Array]
) -> tuple[float, float]:
    """Rms error of the diagnosed recordings without a law, and with it on left-out blocks [output unit]."""
    total = samples = fall = 0.0
    first = 0
    for record, recording, model in zip(records, series, modelled, strict=True):
        error = (recording.reading_N - model)[recording.counts]
        total += float(error.size * np.var(error))
        samples += error.size
        fall += record.noise**2 * float(np.sum((reference - errors)[first : first + record.blocks]))
        first += record.blocks
    before = total / max(samples, 1.0)
    return float(np.sqrt(before)), float(np.sqrt(max(before - fall / max(samples, 1.0), 0.0)))


def _mean(records: Sequence[_Record], axes: Mapping[Driver, Axis], law: _Candidate) -> float:
    """Mean of the law over the recordings [output unit], which is a tare and no part of the law."""
    total = 0.0
    for record in records:
        columns = _columns(record, [axes[name] for name in law.drivers], law.memories_s)
        total += float(record.counts @ (columns @ law.tables.ravel()))
    return total / sum(float(record.counts.sum()) for record in records)


def _relevant_memories(best: _Candidate) -> tuple[float, ...]:
    """Shortest and longest lag whose table has at least a tenth of the largest spread [s]; empty: none."""
    sizes = np.std(best.tables, axis=1)
    relevant = [memory_s for memory_s, size in zip(best.memories_s, sizes, strict=True) if size > 0.1 * sizes.max()]
    lags = [memory_s for memory_s in relevant if memory_s > 0.0]
    return (min(lags), max(lags)) if lags else ()
