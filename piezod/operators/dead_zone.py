"""Weighted one-sided dead-zone operators: the memoryless part of the modified Prandtl-Ishlinskii operator.

    S_r(x) = max(x - r, 0) for r > 0;   x for r = 0;   min(x - r, 0) for r < 0        (3.6)
    y = sum_j w_j S_{r_j}(x)                                                          (3.7)

Unipolar: thresholds 0 = r_0 < ... < r_m. Two-sided: thresholds on both sides of 0. The step works on
`packed[base : base + 2 * count]`: thresholds and weights. It allocates no memory.
Theory: piezod/operators/README.md, "Dead zone".
"""

import numba
import numpy as np

from piezod.arrays import Array
from piezod.errors import ModelError
from piezod.operators.play import check_superposition, inverse_table


@numba.njit(cache=True)
def dead_zone(r: float, x: float) -> float:
    """Output of one dead zone of threshold `r` at the input `x` (3.6).

    Parameters
    ----------
    r
        Threshold [unit of x], any sign; 0: the linear part.
    """
    beyond = x - r
    return beyond if r == 0.0 or (r > 0.0) == (beyond > 0.0) else 0.0


@numba.njit(cache=True)
def dead_zone_step(packed: Array, base: int, count: int, x: float) -> float:
    """Weighted sum of the dead zones at the input `x` (3.7).

    Parameters
    ----------
    packed
        Array with thresholds at `base` and weights at `base + count`.
    base
        Index of the first threshold.
    count
        Number of dead zones, at least 1.
    x
        Input [unit of a threshold].
    """
    y = 0.0
    for j in range(count):
        y += packed[base + count + j] * dead_zone(packed[base + j], x)
    return y


@numba.njit(cache=True)
def dead_zone_run(packed: Array, base: int, count: int, x: Array, y: Array) -> None:
    """Write `dead_zone_step` over the record `x`, shape (N,), into `y`, shape (N,).

    Parameters
    ----------
    packed, base, count
        As in `dead_zone_step`.
    x
        Input record, shape (N,) [unit of a threshold].
    y
        Buffer for the weighted sums, shape (N,).
    """
    for k in range(x.size):
        y[k] = dead_zone_step(packed, base, count, x[k])


@numba.njit(cache=True)
def dead_zone_columns(thresholds: Array, x: Array, columns: Array) -> None:
    """Write each dead zone over the record `x`, shape (N,), into `columns`, shape (N, count): columns of (3.15).

    Parameters
    ----------
    thresholds
        Shape (count,).
    x
        Input record, shape (N,) [unit of a threshold].
    columns
        Buffer for the outputs, shape (N, count) [unit of x].
    """
    for k in range(x.size):
        for j in range(thresholds.size):
            columns[k, j] = dead_zone(thresholds[j], x[k])


def shifted(thresholds: Array, weights: Array, shift: float) -> tuple[Array, Array, float]:
    """Thresholds and weights of S~, and the constant, in S(x + shift) = S~(x) + constant (derived here).

    A threshold that changes its sign changes the side: max(x - r, 0) = x - r - min(x - r, 0).

    Parameters
    ----------
    thresholds, weights
        Dead zones S, shape (m + 1,), one threshold being 0.
    shift
        Added to the input [unit of a threshold].
    """
    moved = thresholds - shift
    centre = float(weights[thresholds == 0.0][0])
    constant = centre * shift
    kept_thresholds, kept_weights = [], []
    for r, moved_r, weight in zip(thresholds, moved, weights, strict=True):
        if r == 0.0:
            continue
        if (r > 0.0) == (moved_r > 0.0) and moved_r != 0.0:
            kept_thresholds.append(moved_r)
            kept_weights.append(weight)
            continue
        centre += weight
        constant -= weight * moved_r
        if moved_r != 0.0:
            kept_thresholds.append(moved_r)
            kept_weights.append(-weight)
    all_thresholds = np.array([*kept_thresholds, 0.0])
    all_weights = np.array([*kept_weights, centre])
    order = np.argsort(all_thresholds)
    return all_thresholds[order], all_weights[order], constant


def split(thresholds: Array, weights: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Both sides as superpositions with thresholds that increase from 0.

    Parameters
    ----------
    thresholds, weights
        Dead zones, shape (m + 1,); thresholds increase, exactly one is 0.

    Returns
    -------
    upper, lower
        Thresholds and weights of the side above 0 and of the side below 0, mirrored.
    """
    (centre,) = np.flatnonzero(thresholds == 0.0)
    upper = thresholds[centre:], weights[centre:]
    lower = -thresholds[centre::-1], weights[centre::-1]
    return upper, lower


def inverse_dead_zone(thresholds: Array, weights: Array) -> tuple[Array, Array]:
    """Thresholds and weights of the inverse (3.31 to 3.33, 3.35, 3.36); applied twice it returns its input.

    Parameters
    ----------
    thresholds, weights
        Dead zones that pass `check_dead_zone`, shape (m + 1,).

    Returns
    -------
    Both of shape (m + 1,): thresholds [unit of the output], weights [inverse of the unit of `weights`].
    """
    upper, lower = split(thresholds, weights)
    upper_thresholds, upper_weights = inverse_table(*upper)
    lower_thresholds, lower_weights = inverse_table(*lower)
    return (
        np.concatenate((-lower_thresholds[:0:-1], upper_thresholds)),
        np.concatenate((lower_weights[:0:-1], upper_weights)),
    )


def check_dead_zone(thresholds: Array, weights: Array, eps: float) -> None:
    """Refuse dead zones without an inverse.

    Parameters
    ----------
    thresholds, weights
        Shape (m + 1,).
    eps
        Smallest accepted slope as a fraction of the steepest slope, 0 to 1. The check thus does not depend on units.

    Raises
    ------
    ModelError
        A slope is too small or a threshold out of order; the message names side, index and value.
    """
    if np.count_nonzero(thresholds == 0.0) != 1 or thresholds.shape != weights.shape:
        raise ModelError(
            f"dead zones: {thresholds.size} thresholds and {weights.size} weights, must be equally many, "
            "exactly one threshold being 0"
        )
    upper, lower = split(thresholds, weights)
    steepest = max(float(np.abs(np.cumsum(side[1])).max()) for side in (upper, lower))
    check_superposition("dead zones above 0", *upper, eps * steepest)
    check_superposition("dead zones below 0", *lower, eps * steepest)
