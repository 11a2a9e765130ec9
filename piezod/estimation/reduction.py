"""The fewest operators that fit as well: neighbouring slopes are made equal as long as the noise hides it.

Two neighbouring slopes that are equal are one operator less. What that costs is read off the normal equations (Wald's
statistic), so nothing is fitted again until the choice stands.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from piezod.estimation.columns import Samples
from piezod.estimation.quadratic_program import Constraints, solve_step
from piezod.estimation.smooth_base import Base, refit

Array = NDArray[np.float64]

WORSE = 0.001
"""Share of the root mean square error that fewer operators may cost on the recording itself. On other work, which goes
where the recording hardly was, it costs more: 0.5 % in the median of twelve concealed plants, where 0.01 costs 2 %."""


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
    together = np.eye(base.parameters.size)
    plays, between = base.structure.plays, base.parameters.size - base.structure.plays - base.zones.size
    slopes, covariance = _solved(base, together)
    while True:
        costs = np.diff(slopes) ** 2 / np.maximum(_variances(covariance), np.finfo(float).tiny)
        costs[plays - 1 : plays + between] = np.inf  # the constant and drifts, between the plays and the force law
        place = int(np.argmin(costs))
        if not np.isfinite(costs[place]):
            break
        fewer = np.delete(together, place + 1, axis=1)
        fewer[:, place] += together[:, place + 1]
        slopes, covariance = _solved(base, fewer)
        if base.sums.expected_loss(fewer @ slopes - base.parameters) - float(base.sums.loss.sum()) > allowed:
            break
        together, plays = fewer, plays - (place < plays)
    first = np.argmax(together != 0.0, axis=0)  # a group keeps the threshold where it begins
    kept_zones = first[plays + between :] - base.structure.plays - between
    structure = replace(
        base.structure,
        play_thresholds=base.structure.play_thresholds[first[:plays]],
        zone_thresholds=base.structure.zone_thresholds[kept_zones],
    )
    curvature, slope = _quadratic(base, together)
    steepest = float(base.parameters[-base.zones.size :].max())
    bounds = Constraints.of(structure, between - 1, variant="B", eps=base.eps)
    means: Array = (together.T @ base.parameters) / together.sum(axis=0)  # of what was made equal
    start = solve_step(
        curvature, slope - curvature @ means, bounds.for_direct(kept_zones.size, base.eps * steepest), means
    )
    penalty = together.T @ base.penalty @ together
    return refit(structure, base.zones[kept_zones], recordings, base.eps, start, penalty)


def _quadratic(base: Base, together: Array) -> tuple[Array, Array]:
    """C, shape (k, k), and b, shape (k,), in the cost x' C x - 2 b' x of the groups' slopes."""
    hessian, gradient = base.sums.hessian.sum(axis=0), base.sums.gradient.sum(axis=0)
    curvature = together.T @ (hessian + base.penalty) @ together
    return curvature, together.T @ (gradient + hessian @ base.parameters)


def _solved(base: Base, together: Array) -> tuple[Array, Array]:
    """Slopes of the groups that fit best, shape (k,), and their covariance times the noise's power, shape (k, k)."""
    equality = base.constraints.equality
    assert equality is not None
    curvature, slope = _quadratic(base, together)
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
