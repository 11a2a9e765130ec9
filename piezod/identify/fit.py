"""One fit of one structure: the quadratic program first, then the error in the output itself is minimised."""

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.estimation.columns import (
    Samples,
    Structure,
    accumulate_gram,
    clocks_of,
    weights_of,
    zone_slopes_of,
    zone_weights_of,
)
from piezod.estimation.normal_equations import Piece, Sums, merged, pieces_of, sums_of
from piezod.estimation.quadratic_program import Constraints, Variant, solve, solve_step
from piezod.estimation.smooth_base import Base
from piezod.model.parameters import Hysteresis, Statistics, Superposition
from piezod.operators import EPS
from piezod.operators.dead_zone import inverse_dead_zone, shifted

Array = NDArray[np.float64]

MOST_STEPS = 12
MOST_RESCALED = 3
MOST_KEPT = 100_000  # samples whose play segments are kept from step to step
SMALLEST_GAIN = 1e-8  # share of the squared error that a further step must promise


@dataclass(frozen=True)
class Fit:
    """What one fit found.

    Parameters
    ----------
    structure
        Which operators.
    hysteresis
        The direct operator.
    gram
        Gram matrix of the quadratic program, shape (q, q): what a later refit needs.
    condition
        Condition number of the columns, each scaled to length 1, without the direction that the normalisation fixes.
    statistics
        What a later refit needs instead of the samples.
    """

    structure: Structure
    hysteresis: Hysteresis
    gram: Array
    condition: float
    statistics: Statistics


def fit_hysteresis(
    structure: Structure, recordings: Sequence[Samples], *, variant: Variant = "B", eps: float = EPS
) -> Fit:
    """Identify one structure.

    Parameters
    ----------
    structure
        Which operators.
    recordings
        Input and output of each.
    variant
        Constraint variant of the quadratic program, "A" or "B".
    eps
        Smallest partial sum of weights.

    Raises
    ------
    RecordingError
        The recording does not determine the model.
    """
    constraints = Constraints.of(structure, clocks_of(recordings), variant=variant, eps=eps)
    gram = accumulate_gram(structure, recordings)
    slopes = solve(gram, constraints)
    free = structure.plays + 1 + clocks_of(recordings)
    inverse_weights = zone_weights_of(structure.zone_thresholds, slopes[free:])
    zones, zone_weights = inverse_dead_zone(structure.zone_thresholds, inverse_weights)
    parameters = np.concatenate((slopes[:free], zone_slopes_of(zones, zone_weights)))
    pieces = _pieces(structure, recordings)
    for _ in range(MOST_RESCALED):  # the smallest slope is a part of the steepest, which the fit may raise
        steepest = float(parameters[free:].max())
        direct = constraints.for_direct(zones.size, eps * steepest)
        parameters[free:] = np.maximum(parameters[free:], eps * steepest)
        parameters = _refine(structure, zones, parameters, pieces, direct)
        if parameters[free:].min() >= eps * parameters[free:].max():
            break
    sums = sums_of(pieces(), structure, zones, parameters)
    return _fit(structure, zones, parameters, sums, gram, eps)


def _pieces(structure: Structure, recordings: Sequence[Samples]) -> Callable[[], Iterable[Piece]]:
    """Pieces for each step: kept where they are few, else made again."""
    if sum(one.u.size for one in recordings) > MOST_KEPT:
        return functools.partial(pieces_of, structure, recordings)
    kept = merged(pieces_of(structure, recordings))
    return lambda: kept


def fit_of_base(base: Base) -> Fit:
    """A fit by the smooth base, as what a model is made of."""
    return _fit(base.structure, base.zones, base.parameters, base.sums, base.sums.hessian.sum(axis=0), base.eps)


def _fit(structure: Structure, zones: Array, parameters: Array, sums: Sums, gram: Array, eps: float) -> Fit:
    bounded, law = parameters.copy(), slice(parameters.size - zones.size, None)
    bounded[law] = np.maximum(bounded[law], (1.0 + 1e-9) * eps * bounded[law].max())
    # a solver keeps a bound to its tolerance only
    bounded[: structure.plays] = np.maximum(bounded[: structure.plays], (1.0 + 1e-9) * eps)
    return Fit(
        structure,
        _as_hysteresis(structure, zones, bounded, eps),
        gram,
        _condition(gram),
        _statistics(structure, zones, bounded, sums),
    )


def _statistics(structure: Structure, zones: Array, parameters: Array, sums: Sums) -> Statistics:
    """Normal equations at the solution; drifts of the recordings are eliminated from them."""
    normal = sums.hessian.sum(axis=0)
    first, count = structure.plays + 1, parameters.size - structure.plays - 1 - zones.size
    kept = np.delete(np.arange(parameters.size), np.arange(first, first + count))
    drifts = normal[first : first + count, first : first + count]
    across = normal[kept][:, first : first + count]
    normal = normal[np.ix_(kept, kept)] - across @ np.linalg.pinv(drifts) @ across.T
    return Statistics(
        samples=int(sums.samples.sum()),
        rms=sums.rms,
        play_slopes=tuple(parameters[: structure.plays].tolist()),
        constant=float(parameters[structure.plays]),
        zone_thresholds=tuple(zones.tolist()),
        zone_slopes=tuple(parameters[-zones.size :].tolist()),
        origin=structure.origin,
        normal=tuple(float(f"{value:.9g}") for value in normal[np.tril_indices(kept.size)]),
    )


def _as_hysteresis(structure: Structure, zones: Array, parameters: Array, eps: float) -> Hysteresis:
    """The constant inside the dead zones moves into their thresholds and the offset."""
    plays = structure.plays
    zone_weights = zone_weights_of(zones, parameters[-zones.size :])
    thresholds, weights, constant = shifted(zones, zone_weights, float(parameters[plays]))
    return Hysteresis(
        plays=Superposition(
            thresholds=tuple(structure.play_thresholds.tolist()), weights=tuple(weights_of(parameters[:plays]).tolist())
        ),
        dead_zones=Superposition(thresholds=tuple(thresholds.tolist()), weights=tuple(weights.tolist())),
        offset=float(structure.origin + constant),
        eps=eps,
    )


def _condition(gram: Array) -> float:
    """From the eigenvalues of the scaled Gram matrix, as far as rounding tells; the smallest is the solution's own."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    values = np.linalg.eigvalsh(gram * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / max(values[1], np.finfo(float).eps * values[-1])))


def _refine(
    structure: Structure,
    zones: Array,
    start: Array,
    pieces: Callable[[], Iterable[Piece]],
    constraints: Constraints,
) -> Array:
    """Gauss-Newton on the output error; each step is a quadratic program, halved until the error falls.

    The first program's error is in the input's unit and has the noisy output among its regressors, which biases the
    dead-zone slopes; the error in the output has not.
    """
    best, step, damping = start, np.zeros_like(start), 1.0
    best_loss = np.inf
    parameters = start
    for _ in range(MOST_STEPS):
        sums = sums_of(pieces(), structure, zones, parameters)
        hessian, gradient, loss = sums.hessian.sum(axis=0), sums.gradient.sum(axis=0), float(sums.loss.sum())
        if loss < best_loss:
            best, best_loss, damping = parameters, loss, 1.0
            step = solve_step(hessian, gradient, constraints, parameters) - parameters
            gain = float(step @ gradient - 0.5 * step @ hessian @ step)
            if 2.0 * gain <= SMALLEST_GAIN * loss:
                break
        else:
            damping *= 0.25
        parameters = best + damping * step
    return best
