"""The quadratic program of the identification (3.11-3.24), solved by ProxQP from accumulated Gram matrices.

    min_w  w' G w   subject to   partial sums of plays and of inverse dead zones >= eps,   H(u_max) = u_max
    w = [play weights, one constant, inverse dead-zone weights],   G = sum over samples of phi phi'

The error is linear in the direct play weights and in the inverse dead-zone weights, so the program is convex.
Columns are scaled to equal length and the Hessian to a mean diagonal of 1; without that ProxQP's tolerance says
nothing about the weights.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import proxsuite
from numpy.typing import NDArray

from piezod.errors import RecordingError
from piezod.identify.columns import Structure

Array = NDArray[np.float64]

TOLERANCE = 1e-12


@dataclass(frozen=True)
class Constraints:
    """What the weights must satisfy: `rows @ w >= low` (3.16, 3.18-3.21), `equality @ w = 1` (3.17 over u_max)."""

    rows: Array
    low: Array
    equality: Array

    @classmethod
    def of(cls, structure: Structure, *, variant: str, eps: float) -> Self:
        """Constraints of a structure.

        Parameters
        ----------
        structure
            Which operators.
        variant
            "A": no play weight negative (the thesis'); "B": no partial sum below eps (necessary and sufficient).
        eps
            Smallest partial sum; of the dead zones as a fraction of input range over output range.
        """
        plays, zones = structure.play_thresholds.size, structure.zone_thresholds.size
        rows = np.zeros((plays + zones, structure.columns))
        rows[:plays, :plays] = np.eye(plays) if variant == "A" else np.tril(np.ones((plays, plays)))
        rows[plays:, plays + 1 :] = outward_sums(structure.zone_thresholds)
        low = np.concatenate((np.full(plays, eps), np.full(zones, eps * structure.zone_scale)))
        if variant == "A":
            low[1:plays] = 0.0
        equality = np.zeros(structure.columns)
        equality[:plays] = 1.0 - structure.play_thresholds / structure.u_max
        return cls(rows, low, equality)

    def for_direct(self, zones: Array) -> Self:
        """The same for direct dead-zone weights, whose slopes are the reciprocals [output unit per V]."""
        rows = self.rows.copy()
        rows[-zones.size :, -zones.size :] = outward_sums(zones)
        low = self.low.copy()
        low[-zones.size :] = 1e-4 / low[-1]
        return replace(self, rows=rows, low=low)


def outward_sums(thresholds: Array) -> Array:
    """Rows that sum the dead-zone weights from the centre outwards, on each side (U_S)."""
    centre = int(np.flatnonzero(thresholds == 0.0)[0])
    rows = np.zeros((thresholds.size, thresholds.size))
    for j in range(thresholds.size):
        rows[j, min(j, centre) : max(j, centre) + 1] = 1.0
    return rows


def solve(gram: Array, constraints: Constraints) -> Array:
    """Weights that minimise w' G w, shape (q,).

    Raises
    ------
    RecordingError
        The solver found no solution.
    """
    nothing = np.zeros(gram.shape[0])
    return solve_step(gram, nothing, constraints, nothing)


def solve_step(hessian: Array, gradient: Array, constraints: Constraints, start: Array) -> Array:
    """`start` + d, where d minimises d' A d / 2 - g' d and start + d satisfies the constraints.

    Parameters
    ----------
    hessian, gradient
        A, shape (q, q), and g, shape (q,).
    constraints
        Of the weights, not of the step.
    start
        Weights that the step starts from.

    Raises
    ------
    RecordingError
        The solver found no solution.
    """
    size = hessian.shape[0]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
    scaled = hessian * np.outer(scale, scale)
    factor = size / np.trace(scaled)
    equality, rows = constraints.equality * scale, constraints.rows * scale
    length, span = np.linalg.norm(rows, axis=1), np.linalg.norm(equality)
    solver = proxsuite.proxqp.dense.QP(size, 1, rows.shape[0])
    solver.settings.eps_abs = TOLERANCE
    solver.settings.eps_rel = 0.0
    solver.settings.max_iter = 10_000
    solver.init(
        factor * scaled,
        -factor * scale * gradient,
        equality[None, :] / span,
        np.array([(1.0 - constraints.equality @ start) / span]),
        rows / length[:, None],
        (constraints.low - constraints.rows @ start) / length,
    )
    solver.solve()
    if solver.results.info.status != proxsuite.proxqp.QPSolverOutput.PROXQP_SOLVED:
        raise RecordingError(
            f"the quadratic program was not solved ({solver.results.info.status.name}): the recording does not "
            "determine the model; record triangles over the whole range, or identify with fewer operators"
        )
    weights: Array = start + scale * np.array(solver.results.x)
    return weights
