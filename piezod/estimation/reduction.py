"""The fewest operators that fit as well: neighbouring slopes are made equal as long as the noise hides it.

Two neighbouring slopes that are equal are one operator less. What that costs is read off the normal equations (Wald's
statistic), so nothing is fitted again. Two slopes that a recording hardly distinguishes may matter elsewhere; so the
change on drawn work over the whole range counts too.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.estimation.columns import Samples
from piezod.estimation.normal_equations import pieces_of, sums_of
from piezod.estimation.quadratic_program import Constraints, solve_step
from piezod.estimation.smooth_base import Base, base_at

Array = NDArray[np.float64]

WORSE = 0.001
"""Share of the root mean square error that fewer operators may cost, on the recording and on drawn work. With 0.005 the
error on other work grew by 15 and 30 % on two of nine concealed plants, with 0.001 by at most 4 % on one."""

PARTS, REVERSALS, SAMPLES_OF_A_MOVE = 10, 40, 20
"""Drawn work: de-energised stacks are moved between levels that are drawn over a tenth to all of the range."""


def reduced(base: Base, recordings: Sequence[Samples], loss: float) -> Base:
    """The same fit with the fewest operators.

    Parameters
    ----------
    base
        With fine tables.
    recordings
        What it was fitted to.
    loss
        Squared error of the fit over every sample [output unit^2].
    """
    allowed = ((1.0 + WORSE) ** 2 - 1.0) * loss
    elsewhere = _elsewhere(base, recordings)
    together = np.eye(base.parameters.size)
    plays, between = base.structure.plays, base.parameters.size - base.structure.plays - base.zones.size
    slopes, covariance = _solved(base, together, elsewhere)
    while True:
        costs = np.diff(slopes) ** 2 / np.maximum(_variances(covariance), np.finfo(float).tiny)
        costs[plays - 1 : plays + between] = np.inf  # the constant and drifts, between the plays and the force law
        place = int(np.argmin(costs))
        if not np.isfinite(costs[place]):
            break
        fewer = np.delete(together, place + 1, axis=1)
        fewer[:, place] += together[:, place + 1]
        slopes, covariance = _solved(base, fewer, elsewhere)
        step = fewer @ slopes - base.parameters
        here = base.sums.expected_loss(step) - float(base.sums.loss.sum())
        if max(here, float(step @ elsewhere @ step)) > allowed:
            break
        together, plays = fewer, plays - (place < plays)
    first = np.argmax(together != 0.0, axis=0)  # a group keeps the threshold where it begins
    kept_zones = first[plays + between :] - base.structure.plays - between
    structure = replace(
        base.structure,
        play_thresholds=base.structure.play_thresholds[first[:plays]],
        zone_thresholds=base.structure.zone_thresholds[kept_zones],
    )
    curvature, slope = _quadratic(base, together, elsewhere)
    steepest = float(base.parameters[-base.zones.size :].max())
    bounds = Constraints.of(structure, between - 1, variant="B", eps=base.eps)
    means: Array = (together.T @ base.parameters) / together.sum(axis=0)  # of what was made equal
    start = solve_step(
        curvature, slope - curvature @ means, bounds.for_direct(kept_zones.size, base.eps * steepest), means
    )
    penalty = together.T @ base.penalty @ together
    return base_at(structure, base.zones[kept_zones], recordings, base.eps, start, penalty)


def _elsewhere(base: Base, recordings: Sequence[Samples]) -> Array:
    """Curvature of the squared change of the output over as many samples of drawn work, shape (q, q)."""
    low, high = min(float(one.u.min()) for one in recordings), max(float(one.u.max()) for one in recordings)
    rng, drawn = np.random.default_rng(REVERSALS), []
    moves = np.arange(REVERSALS * SAMPLES_OF_A_MOVE) / SAMPLES_OF_A_MOVE
    for share in np.arange(1, PARTS + 1) / PARTS:
        levels = low + share * (high - low) * rng.uniform(0.0, 1.0, REVERSALS)
        work = np.interp(moves, np.arange(REVERSALS), levels)
        drawn.append(Samples(work, np.zeros(work.size), np.ones(work.size, dtype=bool), None, ()))
    sums = sums_of(pieces_of(base.structure, drawn), base.structure, base.zones, base.parameters)
    result: Array = sums.hessian.sum(axis=0) * (float(base.sums.samples.sum()) / float(sums.samples.sum()))
    return result


def _quadratic(base: Base, together: Array, elsewhere: Array) -> tuple[Array, Array]:
    """C, shape (k, k), and b, shape (k,), in the cost x' C x - 2 b' x of the groups' slopes."""
    hessian, gradient = base.sums.hessian.sum(axis=0) + elsewhere, base.sums.gradient.sum(axis=0)
    curvature = together.T @ (hessian + base.penalty) @ together
    return curvature, together.T @ (gradient + hessian @ base.parameters)


def _solved(base: Base, together: Array, elsewhere: Array) -> tuple[Array, Array]:
    """Slopes of the groups that fit best, shape (k,), and their covariance times the noise's power, shape (k, k)."""
    equality = base.constraints.equality
    assert equality is not None
    curvature, slope = _quadratic(base, together, elsewhere)
    row = equality @ together
    free = np.linalg.svd(row[None, :])[2][1:].T
    fixed = row / (row @ row)
    covariance = free @ np.linalg.inv(free.T @ curvature @ free) @ free.T
    slopes: Array = fixed + covariance @ (slope - curvature @ fixed)
    return slopes, covariance


def _variances(covariance: Array) -> Array:
    """Of the differences of neighbours, shape (k - 1,)."""
    own = np.diag(covariance)
    result: Array = own[:-1] + own[1:] - 2.0 * np.diag(covariance, 1)
    return result
