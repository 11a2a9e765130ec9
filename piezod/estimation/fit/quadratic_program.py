"""The quadratic program of the identification (3.11-3.24), solved by ProxQP from accumulated Gram matrices.

    min_s  s' G s   subject to   slopes >= eps,   H(u_max) = u_max
    s = [play slopes, a constant, a drift for each recording, inverse dead-zone slopes],   G = sum of phi phi'

The error is linear in the direct play slopes and in the inverse dead-zone slopes, so the program is convex. Columns are
scaled to equal length and the Hessian to a mean diagonal of 1, so that ProxQP's tolerance applies to every slope.
Each step of the Gauss-Newton minimisation of the output error is such a program too.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, Self

import numpy as np
import proxsuite

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.estimation.fit.blocks import Blocks
from piezod.estimation.fit.columns import Structure

Variant = Literal["A", "B"]

MOST_ITERATIONS = 60  # ProxQP converges within some tens of steps, or rounding prevents the tolerance
PROXIMAL = 1e-10
"""Regularisation of ProxQP's outer steps, on the scaled program: a slope whose curvature is far below it takes hundreds
of steps (10,000 inner ones at ProxQP's own 1e-6), and rounding leaves 1e-14."""
ACTIVE = 1e-9  # least multiplier of an active constraint, relative to the largest
LONGEST = 1.1  # longest step relative to that of ProxQP; a longer one has left along a direction without curvature
FEASIBLE = 1e-9  # largest violation of a constraint: the coarsest tolerance of ProxQP
TOLERANCES = (1e-12, 1e-10, 1e-9)  # absolute, on the scaled program, tried in turn
SHORTENED = 0.25  # factor by which a Gauss-Newton step that raises the cost is shortened


@dataclass(frozen=True)
class Constraints:
    """Constraints of the slopes: `rows @ s >= low` (3.16, 3.18-3.21), and `equality @ s = 1` (3.17 over u_max)."""

    rows: Array
    low: Array
    equality: Array | None = None

    @classmethod
    def of(cls, structure: Structure, clocks: int, *, variant: Variant, eps: float) -> Self:
        """Constraints of a structure.

        Parameters
        ----------
        clocks
            Number of free columns after the constant.
        variant
            "A": no play weight negative (the thesis); "B": no partial sum below eps (necessary and sufficient).
        eps
            Smallest slope; of the inverse dead zones as a fraction of input range over output range.
        """
        plays, zones = structure.plays, int(structure.zone_thresholds.size)
        size = structure.columns + clocks
        rows = np.zeros((plays + zones, size))
        rows[:plays, :plays] = np.eye(plays)
        if variant == "A":
            rows[1:plays, : plays - 1] -= np.eye(plays - 1)
        rows[plays:, size - zones :] = np.eye(zones)
        low = np.concatenate((np.full(plays, eps), np.full(zones, eps * structure.zone_scale)))
        if variant == "A":
            low[1:plays] = 0.0
        equality = np.zeros(size)
        equality[:plays] = np.diff(structure.play_thresholds, append=structure.u_max) / structure.u_max
        return cls(rows, low, equality)

    def for_direct(self, zones: int, steepest: float) -> Self:
        """Constraints for direct dead-zone slopes instead, at least `steepest` [output unit per input unit]."""
        low = self.low.copy()
        low[-zones:] = steepest
        return replace(self, low=low)


def solve_step(hessian: Array, gradient: Array, constraints: Constraints, start: Array) -> Array:
    """`start` + d, where d minimises d' A d / 2 - g' d and start + d satisfies the constraints.

    Parameters
    ----------
    hessian, gradient
        A, shape (q, q), and g, shape (q,).
    start
        Slopes before the step, shape (q,).

    Raises
    ------
    RecordingError
        The solver found no solution.
    """
    size = hessian.shape[0]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
    scaled = hessian * np.outer(scale, scale)
    factor = size / np.trace(scaled)
    equalities = np.empty((0, size)) if constraints.equality is None else constraints.equality[None, :]
    equality, rows = equalities * scale, constraints.rows * scale
    length, span = np.linalg.norm(rows, axis=1), np.linalg.norm(equality, axis=1)
    length[length == 0.0] = 1.0  # an empty row is no constraint
    linear, value = -factor * scale * gradient, (1.0 - equalities @ start) / span
    low = (constraints.low - constraints.rows @ start) / length
    largest = max(float(np.abs(terms).max(initial=0.0)) for terms in (linear, value, low))
    for unit in (1.0, largest):  # in a unit that makes numbers huge, rounding exceeds the tolerances
        try:
            step = _proxqp(
                factor * scaled,
                linear / unit,
                equality / span[:, None],
                value / unit,
                rows / length[:, None],
                low / unit,
            )
        except RecordingError:
            if unit == largest:
                raise
        else:
            break
    slopes: Array = start + unit * scale * step
    return slopes


def minimise(
    sums_at: Callable[[Array], Blocks],
    bounds_at: Callable[[Array], Constraints],
    start: Array,
    penalty: Array,
    enough: float,
    most_steps: int,
) -> tuple[Array, Blocks]:
    """Parameters p with the least squared output error + p' penalty p by Gauss-Newton steps, and their sums.

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


def _proxqp(hessian: Array, gradient: Array, equality: Array, value: Array, rows: Array, low: Array) -> Array:
    """Minimise x' H x / 2 + g' x under A x = b and C x >= l, as exactly as rounding allows."""
    solver = proxsuite.proxqp.dense.QP(hessian.shape[0], equality.shape[0], rows.shape[0])
    solver.settings.eps_rel = 0.0
    solver.settings.max_iter = MOST_ITERATIONS
    solver.settings.default_rho = PROXIMAL
    solver.init(hessian, gradient, equality, value, rows, low)
    for tolerance in TOLERANCES:
        solver.settings.eps_abs = tolerance
        solver.solve()
        if solver.results.info.status == proxsuite.proxqp.QPSolverOutput.PROXQP_SOLVED:
            found = np.array(solver.results.x)
            active = np.abs(solver.results.z) > ACTIVE * max(1.0, float(np.abs(solver.results.z).max(initial=0.0)))
            active_rows, values = np.vstack((equality, rows[active])), np.append(value, low[active])
            exact = _with_active(hessian, gradient, active_rows, values, found)
            feasible = np.all(rows @ exact >= low - FEASIBLE) and np.all(np.abs(equality @ exact - value) <= FEASIBLE)
            feasible = feasible and np.linalg.norm(exact) <= LONGEST * np.linalg.norm(found)
            return exact if feasible else found
    raise RecordingError(
        f"the quadratic program was not solved ({solver.results.info.status.name}): the recording does not "
        "determine the model; record triangles over the whole range, or identify with fewer operators"
    )


def _with_active(hessian: Array, gradient: Array, rows: Array, values: Array, found: Array) -> Array:
    """Minimum of x' H x / 2 + g' x where the active constraints are equations; equal bits for equal arguments.

    ProxQP's own result depends on where its memory lies. In a direction of little curvature it differs by percents. A
    parameter without curvature stays as `found`.
    """
    exact, moves = found.copy(), np.diag(hessian) > 0.0
    size, count = np.count_nonzero(moves), values.size
    inner, across = hessian[np.ix_(moves, moves)], rows[:, moves]
    matrix = np.block([[inner, across.T], [across, np.zeros((count, count))]])
    side = np.append(-gradient[moves], values - rows[:, ~moves] @ found[~moves])
    exact[moves] = np.linalg.lstsq(matrix, side, rcond=PROXIMAL)[0][:size]
    return exact
