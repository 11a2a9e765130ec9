"""Gauss-Newton minimisation of the squared output error with a quadratic penalty."""

from collections.abc import Callable

import numpy as np

from piezod.arrays import Array
from piezod.estimation.fit.blocks import Blocks
from piezod.estimation.fit.quadratic_program import Constraints, solve_step

SHORTENED = 0.25  # factor by which a step that raises the cost is shortened


def minimise(
    sums_at: Callable[[Array], Blocks],
    bounds_at: Callable[[Array], Constraints],
    start: Array,
    penalty: Array,
    enough: float,
    most_steps: int,
) -> tuple[Array, Blocks]:
    """Parameters p with the least loss + p' penalty p, and their normal equations.

    Parameters
    ----------
    sums_at, bounds_at
        Normal equations and constraints at given parameters, shape (q,).
    start, penalty
        Shape (q,), and (q, q) [output unit^2].
    enough
        Share of the cost below which the expected decrease ends the minimisation.
    most_steps
        Largest number of evaluations, 1 or more.
    """
    best, best_cost, best_sums = start, np.inf, None
    step, length, parameters = np.zeros_like(start), 1.0, start
    for _ in range(most_steps):
        sums = sums_at(parameters)
        cost = float(sums.square.sum() + parameters @ penalty @ parameters)
        if cost < best_cost:
            best, best_cost, best_sums, length = parameters, cost, sums, 1.0
            step = penalised_step(sums, bounds_at(best), penalty, best)
            after = float(sums.errors(step).sum()) + float((best + step) @ penalty @ (best + step))
            if best_cost - after <= enough * best_cost:
                break
        else:
            length *= SHORTENED
        parameters = best + length * step
    assert best_sums is not None
    return best, best_sums


def penalised_step(sums: Blocks, bounds: Constraints, penalty: Array, at: Array) -> Array:
    """Step from the parameters `at` to the minimum of the quadratic approximation within bounds, shape (q,)."""
    gram, side = sums.total
    return solve_step(gram + penalty, side - penalty @ at, bounds, at) - at
