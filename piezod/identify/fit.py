"""One fit of one structure: the quadratic program first, then the error in the force itself is minimised."""

import numpy as np
from numpy.typing import NDArray

from piezod.identify.columns import CHUNK, Regressors, Structure, accumulate_gram
from piezod.identify.qp import Constraints, solve, solve_step
from piezod.model.parameters import Hysteresis, Superposition
from piezod.operators import EPS
from piezod.operators.dead_zone import dead_zone_columns, inverse_dead_zone, shifted

Array = NDArray[np.float64]

MOST_STEPS = 12


def fit_hysteresis(structure: Structure, u: Array, y: Array, *, variant: str = "B", eps: float = EPS) -> Hysteresis:
    """Identify one structure on one recording that starts de-energised.

    Parameters
    ----------
    structure
        Which operators.
    u, y
        Input [V] and output, shape (N,).
    variant
        Constraint variant of the quadratic program, "A" or "B".
    eps
        Smallest partial sum of weights.

    Raises
    ------
    RecordingError
        The recording does not determine the model.
    """
    constraints = Constraints.of(structure, variant=variant, eps=eps)
    weights = solve(accumulate_gram(structure, u, y), constraints)
    plays = structure.play_thresholds.size
    zones, zone_weights = inverse_dead_zone(structure.zone_thresholds, weights[plays + 1 :])
    parameters = np.concatenate((weights[: plays + 1], zone_weights))
    if zones.size > 1:
        parameters = _refine(structure, zones, parameters, u, y, constraints)
    return _as_hysteresis(structure, zones, parameters, eps)


def _as_hysteresis(structure: Structure, zones: Array, parameters: Array, eps: float) -> Hysteresis:
    """The constant inside the dead zones moves into their thresholds and the offset."""
    plays = structure.play_thresholds.size
    thresholds, weights, constant = shifted(zones, parameters[plays + 1 :], float(parameters[plays]))
    return Hysteresis(
        plays=Superposition(thresholds=tuple(structure.play_thresholds), weights=tuple(parameters[:plays])),
        dead_zones=Superposition(thresholds=tuple(thresholds), weights=tuple(weights)),
        offset=structure.origin + constant,
        eps=eps,
    )


def _refine(structure: Structure, zones: Array, start: Array, u: Array, y: Array, constraints: Constraints) -> Array:
    """Gauss-Newton on the output error; each step is the quadratic program with a linear term.

    The program's error is in volts and has the noisy force among its regressors, which biases the dead-zone weights;
    the error in the force has not.
    """
    best, best_loss = start, np.inf
    parameters, damping = start, 1.0
    for _ in range(MOST_STEPS):
        hessian, gradient, loss = _normal_equations(structure, zones, parameters, u, y)
        if loss >= best_loss * (1.0 - 1e-12):
            damping *= 0.25
            if damping < 1e-3:
                break
        else:
            best, best_loss = parameters, loss
            full = solve_step(hessian, gradient, constraints.for_direct(zones), parameters)
            best_step = full - parameters
            damping = 1.0
            if np.abs(best_step).max() <= 1e-14 * np.abs(parameters).max():
                break
        parameters = best + damping * best_step
    return best


def _normal_equations(
    structure: Structure, zones: Array, parameters: Array, u: Array, y: Array
) -> tuple[Array, Array, float]:
    """J'J, J'e and e'e of the error in the output, one pass over the samples."""
    plays = structure.play_thresholds.size
    size = parameters.size
    hessian, gradient, loss = np.zeros((size, size)), np.zeros(size), 0.0
    regressors = Regressors(structure)
    slopes_at = zones
    zone_weights = parameters[plays + 1 :]
    for start in range(0, u.size, CHUNK):
        states = regressors.plays(u[start : start + CHUNK])
        v = states @ parameters[:plays] + parameters[plays]
        columns = np.empty((v.size, zones.size))
        dead_zone_columns(zones, v, columns)
        error = y[start : start + CHUNK] - structure.origin - columns @ zone_weights
        slope = (((columns != 0.0) | (slopes_at == 0.0)) @ zone_weights)[:, None]
        jacobian = np.hstack((slope * states, slope, columns))
        hessian += jacobian.T @ jacobian
        gradient += jacobian.T @ error
        loss += float(error @ error)
    return hessian, gradient, loss
