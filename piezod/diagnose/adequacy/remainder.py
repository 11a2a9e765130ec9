"""What is left while the bench moves or stands high, beside what is left while it rests: noise knows no difference."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]

WINDOW_S, FEWEST_IN_WINDOW = 0.25, 20
FEWEST_WINDOWS, FEWEST_QUIET = 30, 6
STILL = 0.02  # of the usual movement: windows that move less are at rest
LOWEST = 0.2  # of the windows, where fewer rest
BELIEVED = 0.005  # part of all shifts that may order both as well by chance


@dataclass(frozen=True)
class Motion:
    """How much of a residual depends on how the bench stands or moves.

    Parameters
    ----------
    share
        Part of its power within short windows that lies above that of the windows at rest; 0 where that may be chance.
    level_share
        Part of its power that lies above that of the windows with the least force; 0 where that may be chance.
    """

    share: float
    level_share: float


def motion(series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array], *, seed: int = 0) -> Motion:
    """Ask whether a residual's power follows movement or level of the force.

    Parameters
    ----------
    series
        Only those with the role "recording" are looked at.
    residuals, modelled
        Reading less simulation, and simulation; each shape (N,) [N].
    seed
        Of the shifts.
    """
    rng = np.random.default_rng(seed)
    told = [
        _windows(one, residual / one.noise_N, model)
        for one, residual, model in zip(series, residuals, modelled, strict=True)
        if one.role == "recording"
    ]
    told = [one for one in told if one.within.size >= FEWEST_WINDOWS]
    if not told:
        return Motion(0.0, 0.0)
    return Motion(
        _share([(one.within, one.moves, one.moves <= STILL * float(np.median(one.moves))) for one in told], rng),
        _share([(one.whole, one.level, np.zeros(one.level.size, bool)) for one in told], rng),
    )


@dataclass(frozen=True)
class _Windows:
    within: Array  # power of the residual about its mean in the window
    whole: Array  # the same about its mean in the record
    moves: Array  # how far the force moves in the window and the one before [N]
    level: Array  # force above the least [N]


def _windows(series: Series, residual: Array, model_N: Array) -> _Windows:
    size = max(int(WINDOW_S / series.dt_s), FEWEST_IN_WINDOW)
    count = series.time_s.size // size
    cut = slice(0, count * size)
    centred = residual - float(residual[series.counts].mean())
    parts, there = centred[cut].reshape(count, size), series.counts[cut].reshape(count, size)
    model = model_N[cut].reshape(count, size)
    moves = np.ptp(model, axis=1)
    moves[1:] = np.maximum(moves[1:], moves[:-1])
    complete = np.asarray(there.all(axis=1)) & (np.arange(count) > 0)
    lattice = series.lattice_N / series.noise_N
    least = max(lattice**2 / 12.0, 1e-12)
    return _Windows(
        np.maximum(parts.var(axis=1), least)[complete],
        np.maximum(np.mean(parts**2, axis=1), least)[complete],
        moves[complete],
        (model.mean(axis=1) - float(model_N.min()))[complete],
    )


def _share(told: Sequence[tuple[Array, Array, NDArray[np.bool_]]], rng: np.random.Generator) -> float:
    """Part of the power above that at the low end of a quantity, 0 where the order of both may be chance."""
    ranks = [(_ranks(power), _ranks(quantity)) for power, quantity, _ in told]
    found = sum(float(p @ q) for p, q in ranks)
    size = max(p.size for p, _ in ranks)
    starts = [int(rng.integers(0, p.size)) for p, _ in ranks]
    starts[0] = 0
    by_chance = np.array(
        [
            sum(float(np.roll(p, first + k) @ q) for (p, q), first in zip(ranks, starts, strict=True))
            for k in range(1, size)
        ]
    )
    if np.mean(by_chance >= found) > BELIEVED:
        return 0.0
    above, total = 0.0, 0.0
    for power, quantity, low in told:
        quiet = low
        if np.count_nonzero(low) < FEWEST_QUIET:
            quiet = quantity <= float(np.quantile(quantity, LOWEST))
        above += float(np.sum(power - power[quiet].mean()))
        total += float(power.sum())
    return max(above / total, 0.0)


def _ranks(values: Array) -> Array:
    """Places in order, about 0, of length 1."""
    order = np.empty(values.size)
    order[np.argsort(values, kind="stable")] = np.arange(values.size)
    order -= order.mean()
    result: Array = order / max(float(np.linalg.norm(order)), 1e-300)
    return result
