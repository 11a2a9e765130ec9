"""Reduction to the fewest operators that fit as well: neighbouring slopes are made equal while the error hardly grows.

Making two neighbouring slopes equal removes an operator. The normal equations give the cost (Wald's statistic) without
a new fit. Slopes that a recording hardly distinguishes may matter for another input. Therefore the change of the output
over random inputs in the full range is limited too.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezod.arrays import Array
from piezod.estimation.base.smooth_base import Base, base_at
from piezod.estimation.fit.columns import Samples
from piezod.estimation.fit.normal_equations import pieces_of, sums_of
from piezod.estimation.fit.quadratic_program import Constraints, solve_step

WORSE = 0.001
"""Growth of the rms error by which the reduction is limited, on the recordings and on random inputs.

With 0.005 the error on new recordings grew by 15 and 30 % on two of nine concealed plants, with 0.001 by at most 4 %.
"""

PARTS, REVERSALS, SAMPLES_OF_A_MOVE = 10, 40, 20
"""Random inputs: each starts de-energised and moves between random levels, within 10 to 100 % of the range."""


def reduced(base: Base, recordings: Sequence[Samples], loss: float) -> Base:
    """Reduce a fit to the fewest operators.

    Parameters
    ----------
    base
        Fit with fine tables to the recordings.
    loss
        Squared error of the fit over every sample [output unit^2].
    """
    allowed = ((1.0 + WORSE) ** 2 - 1.0) * loss
    elsewhere = _random_input_curvature(base, recordings)
    merging = np.eye(base.parameters.size)  # row: slope, column: group of equal slopes
    plays, between = base.structure.plays, base.parameters.size - base.structure.plays - base.zones.size
    slopes, covariance = _solved(base, merging, elsewhere)
    while True:
        costs = np.diff(slopes) ** 2 / np.maximum(_variances(covariance), np.finfo(float).tiny)
        costs[plays - 1 : plays + between] = np.inf  # the constant and the drifts stay
        place = int(np.argmin(costs))
        if not np.isfinite(costs[place]):
            break
        fewer = np.delete(merging, place + 1, axis=1)
        fewer[:, place] += merging[:, place + 1]
        slopes, covariance = _solved(base, fewer, elsewhere)
        step = fewer @ slopes - base.parameters
        growth = float(base.sums.errors(step).sum() - base.sums.square.sum())
        if max(growth, float(step @ elsewhere @ step)) > allowed:
            break
        merging, plays = fewer, plays - (place < plays)
    first = np.argmax(merging != 0.0, axis=0)  # a group gets the threshold of its first slope
    zones = first[plays + between :] - base.structure.plays - between
    structure = replace(
        base.structure,
        play_thresholds=base.structure.play_thresholds[first[:plays]],
        zone_thresholds=base.structure.zone_thresholds[zones],
    )
    curvature, slope = _quadratic(base, merging, elsewhere)
    steepest = float(base.parameters[-base.zones.size :].max())
    bounds = Constraints.of(structure, between - 1, variant="B", eps=base.eps).for_direct(
        zones.size, base.eps * steepest
    )
    means: Array = (merging.T @ base.parameters) / merging.sum(axis=0)  # of each group
    start = solve_step(curvature, slope - curvature @ means, bounds, means)
    penalty = merging.T @ base.penalty @ merging
    return base_at(structure, base.zones[zones], recordings, base.eps, start, penalty)


def _random_input_curvature(base: Base, recordings: Sequence[Samples]) -> Array:
    """Curvature of the squared change of the output over random inputs, per as many samples, shape (q, q)."""
    low = min(float(samples.u.min()) for samples in recordings)
    high = max(float(samples.u.max()) for samples in recordings)
    rng, drawn = np.random.default_rng(REVERSALS), []
    moves = np.arange(REVERSALS * SAMPLES_OF_A_MOVE) / SAMPLES_OF_A_MOVE
    for share in np.arange(1, PARTS + 1) / PARTS:
        levels = low + share * (high - low) * rng.uniform(0.0, 1.0, REVERSALS)
        work = np.interp(moves, np.arange(REVERSALS), levels)
        drawn.append(Samples(work, np.zeros(work.size), np.ones(work.size, dtype=bool), None, ()))
    sums = sums_of(pieces_of(base.structure, drawn), base.structure, base.zones, base.parameters)
    result: Array = sums.total[0] * (float(base.sums.samples.sum()) / float(sums.samples.sum()))
    return result


def _quadratic(base: Base, merging: Array, elsewhere: Array) -> tuple[Array, Array]:
    """C, shape (k, k), and b, shape (k,), in the cost x' C x - 2 b' x of the groups' slopes."""
    gram, side = base.sums.total
    hessian = gram + elsewhere
    curvature = merging.T @ (hessian + base.penalty) @ merging
    return curvature, merging.T @ (side + hessian @ base.parameters)


def _solved(base: Base, merging: Array, elsewhere: Array) -> tuple[Array, Array]:
    """Best slopes of the groups, shape (k,), and their covariance over the noise variance, shape (k, k)."""
    equality = base.constraints.equality
    assert equality is not None
    curvature, slope = _quadratic(base, merging, elsewhere)
    row = equality @ merging
    free = np.linalg.svd(row[None, :])[2][1:].T
    fixed = row / (row @ row)
    covariance = free @ np.linalg.inv(free.T @ curvature @ free) @ free.T
    slopes: Array = fixed + covariance @ (slope - curvature @ fixed)
    return slopes, covariance


def _variances(covariance: Array) -> Array:
    """Variances of the differences between neighbouring slopes, shape (k - 1,)."""
    diagonal = np.diag(covariance)
    result: Array = diagonal[:-1] + diagonal[1:] - 2.0 * np.diag(covariance, 1)
    return result
