"""Fit of one structure: first the quadratic program, then Gauss-Newton steps on the output error."""

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.estimation.base.smooth_base import Base
from piezod.estimation.fit.blocks import Blocks
from piezod.estimation.fit.columns import (
    Samples,
    Structure,
    clocks_of,
    weights_of,
    zone_slopes_of,
    zone_weights_of,
)
from piezod.estimation.fit.normal_equations import Piece, accumulate_gram, merged, pieces_of, sums_of
from piezod.estimation.fit.quadratic_program import Constraints, Variant, minimise, solve_step
from piezod.model.parameters import Hysteresis, Superposition
from piezod.operators import EPS
from piezod.operators.dead_zone import inverse_dead_zone, shifted

MOST_STEPS = 12
MOST_RESCALED = 3
MOST_CACHED = 100_000  # samples up to which the play segments are stored between the steps
SMALLEST_GAIN = 1e-8  # share of the squared error by which a further step must be expected to lower it


@dataclass(frozen=True)
class Fit:
    """Result of one fit.

    Parameters
    ----------
    structure, hysteresis
        Thresholds of the fit, and the direct operator.
    gram
        Gram matrix of the quadratic program, shape (q, q).
    condition
        Condition number of the columns, each scaled to length 1, without the direction that the normalisation fixes.
    rms
        Root mean square error [output unit].
    """

    structure: Structure
    hysteresis: Hysteresis
    gram: Array
    condition: float
    rms: float


def fit_hysteresis(
    structure: Structure, recordings: Sequence[Samples], *, variant: Variant = "B", eps: float = EPS
) -> Fit:
    """Identify one structure.

    Parameters
    ----------
    variant
        Constraints of the quadratic program, see `Constraints.of`.
    eps
        Smallest partial sum of weights, as a share of the steepest one.

    Raises
    ------
    RecordingError
        The recordings do not determine the model.
    """
    constraints = Constraints.of(structure, clocks_of(recordings), variant=variant, eps=eps)
    pieces = _pieces(structure, recordings)
    gram = accumulate_gram(structure, pieces())
    nothing = np.zeros(gram.shape[0])
    slopes = solve_step(gram, nothing, constraints, nothing)
    free = structure.plays + 1 + clocks_of(recordings)
    inverse_weights = zone_weights_of(structure.zone_thresholds, slopes[free:])
    zones, zone_weights = inverse_dead_zone(structure.zone_thresholds, inverse_weights)
    parameters = np.concatenate((slopes[:free], zone_slopes_of(zones, zone_weights)))
    for _ in range(MOST_RESCALED):  # the bound is a share of the steepest slope, which the fit may raise
        steepest = float(parameters[free:].max())
        direct = constraints.for_direct(zones.size, eps * steepest)
        parameters[free:] = np.maximum(parameters[free:], eps * steepest)
        parameters, sums = _refine(structure, zones, parameters, pieces, direct)
        if parameters[free:].min() >= eps * parameters[free:].max():
            break
    return _fit(structure, zones, parameters, sums, gram, eps)


def _pieces(structure: Structure, recordings: Sequence[Samples]) -> Callable[[], Iterable[Piece]]:
    """Pieces for each step: stored for up to `MOST_CACHED` samples, else computed at each step."""
    if sum(samples.u.size for samples in recordings) > MOST_CACHED:
        return functools.partial(pieces_of, structure, recordings)
    cache = merged(pieces_of(structure, recordings))
    return lambda: cache


def fit_of_base(base: Base) -> Fit:
    """The smooth base as a `Fit`, from which a model is made."""
    return _fit(base.structure, base.zones, base.parameters, base.sums, base.sums.total[0], base.eps)


def _fit(structure: Structure, zones: Array, parameters: Array, sums: Blocks, gram: Array, eps: float) -> Fit:
    bounded, law = parameters.copy(), slice(parameters.size - zones.size, None)
    bounded[law] = np.maximum(bounded[law], (1.0 + 1e-9) * eps * bounded[law].max())
    # the solver satisfies a bound within its tolerance only
    bounded[: structure.plays] = np.maximum(bounded[: structure.plays], (1.0 + 1e-9) * eps)
    return Fit(
        structure,
        _as_hysteresis(structure, zones, bounded, eps),
        gram,
        _condition(gram),
        sums.rms,
    )


def _as_hysteresis(structure: Structure, zones: Array, parameters: Array, eps: float) -> Hysteresis:
    """The direct operator: the constant inside the dead zones moves into their thresholds and the offset."""
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
    """From the eigenvalues of the scaled Gram matrix, within rounding; the smallest belongs to the solution itself."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
    values = np.linalg.eigvalsh(gram * np.outer(scale, scale))
    return float(np.sqrt(values[-1] / max(values[1], np.finfo(float).eps * values[-1])))


def _refine(
    structure: Structure,
    zones: Array,
    start: Array,
    pieces: Callable[[], Iterable[Piece]],
    constraints: Constraints,
) -> tuple[Array, Blocks]:
    """Parameters with the least output error, and their normal equations.

    The error of the first program is in the input's unit. Its regressors contain the noisy output, which biases the
    dead-zone slopes; the regressors of the output error do not.
    """

    def sums_at(parameters: Array) -> Blocks:
        return sums_of(pieces(), structure, zones, parameters)

    no_penalty = np.zeros((start.size, start.size))
    return minimise(sums_at, lambda _: constraints, start, no_penalty, SMALLEST_GAIN, MOST_STEPS)
