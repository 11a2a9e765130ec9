"""Dependence of a residual's power on the motion and the level of the force, on which noise does not depend."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.recordings.series import Series

WINDOW_S, FEWEST_IN_WINDOW = 0.25, 20  # length of a window [s], at least so many samples
FEWEST_WINDOWS, FEWEST_QUIET = 30, 6  # windows for a test, and windows at rest for its reference
REST = 0.02  # motion in a window over the median motion below which the bench rests
LOWEST = 0.2  # share of the windows, with the smallest motion or force, that replaces too few windows at rest
SIGNIFICANT = 0.005  # largest share of circular shifts that correlate as strongly


@dataclass(frozen=True)
class Motion:
    """Shares of the residual's power that depend on motion or level."""

    share: float  # share of the power within windows that exceeds the power at rest; 0 if not significant
    level_share: float  # share of the power that exceeds the power at the smallest force; 0 if not significant


def motion_of(series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array]) -> Motion:
    """Test whether the residual's power in the diagnosed recordings follows the motion or the level of the force.

    `series` are recordings of any role; `residuals` and `modelled` have shape (N,) each [N].
    """
    rng = np.random.default_rng(0)
    windows = [
        _Windows.of(s, residual / s.noise_N, model_N)
        for s, residual, model_N in zip(series, residuals, modelled, strict=True)
        if s.role == "recording"
    ]
    windows = [w for w in windows if w.variance.size >= FEWEST_WINDOWS]
    if not windows:
        return Motion(0.0, 0.0)
    return Motion(
        _excess_share([(w.variance, w.moves_N, w.moves_N <= REST * float(np.median(w.moves_N))) for w in windows], rng),
        _excess_share([(w.power, w.level_N, np.zeros(w.level_N.size, bool)) for w in windows], rng),
    )


@dataclass(frozen=True)
class _Windows:
    """Complete windows of a recording.

    Parameters
    ----------
    variance, power
        Mean square of the residual about its mean in the window, and about its mean in the recording.
    moves_N, level_N
        Range of the force in the window and the previous one, and mean force above the smallest force [N].
    """

    variance: Array
    power: Array
    moves_N: Array
    level_N: Array

    @classmethod
    def of(cls, series: Series, residual: Array, model_N: Array) -> "_Windows":
        size = max(int(WINDOW_S / series.dt_s), FEWEST_IN_WINDOW)
        count = series.time_s.size // size
        cut = slice(0, count * size)
        centred = residual - float(residual[series.counts].mean())
        parts, counts = centred[cut].reshape(count, size), series.counts[cut].reshape(count, size)
        model = model_N[cut].reshape(count, size)
        moves_N = np.ptp(model, axis=1)
        moves_N[1:] = np.maximum(moves_N[1:], moves_N[:-1])
        complete = np.asarray(counts.all(axis=1)) & (np.arange(count) > 0)
        step = series.lattice_N / series.noise_N
        least = max(step**2 / 12.0, 1e-12)
        return cls(
            np.maximum(parts.var(axis=1), least)[complete],
            np.maximum(np.mean(parts**2, axis=1), least)[complete],
            moves_N[complete],
            (model.mean(axis=1) - float(model_N.min()))[complete],
        )


def _excess_share(windows: Sequence[tuple[Array, Array, NDArray[np.bool_]]], rng: np.random.Generator) -> float:
    """Share of the power above that at small values of a quantity; 0 if their rank correlation is not significant.

    `windows`: power, quantity, and mask of the reference windows, of each recording.
    """
    ranks = [(_ranks(power), _ranks(quantity)) for power, quantity, _ in windows]
    correlation = sum(float(p @ q) for p, q in ranks)
    size = max(p.size for p, _ in ranks)
    starts = [int(rng.integers(0, p.size)) for p, _ in ranks]
    starts[0] = 0
    shifted = np.array(
        [
            sum(float(np.roll(p, first + k) @ q) for (p, q), first in zip(ranks, starts, strict=True))
            for k in range(1, size)
        ]
    )
    if np.mean(shifted >= correlation) > SIGNIFICANT:
        return 0.0
    excess, total = 0.0, 0.0
    for power, quantity, reference in windows:
        if np.count_nonzero(reference) < FEWEST_QUIET:
            quiet = quantity <= float(np.quantile(quantity, LOWEST))
        else:
            quiet = reference
        excess += float(np.sum(power - power[quiet].mean()))
        total += float(power.sum())
    return max(excess / total, 0.0)


def _ranks(values: Array) -> Array:
    """Ranks with mean 0 and norm 1."""
    order = np.empty(values.size)
    order[np.argsort(values, kind="stable")] = np.arange(values.size)
    order -= order.mean()
    result: Array = order / max(float(np.linalg.norm(order)), 1e-300)
    return result
