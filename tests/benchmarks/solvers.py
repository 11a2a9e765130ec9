"""The quadratic program by ProxQP beside quadprog, OSQP and scipy's nnls: time, and the error of the weights.

The program is that of a known model, noise-free, so the true slopes are known. All get the same scaled matrices.
"""

import contextlib
from collections.abc import Callable, Iterator
from time import perf_counter_ns

import numpy as np
from scipy.optimize import nnls

from piezod.errors import RecordingError
from piezod.estimation.base.thresholds import dead_zone_thresholds, play_thresholds
from piezod.estimation.fit.columns import Samples, Structure
from piezod.estimation.fit.normal_equations import accumulate_gram, pieces_of
from piezod.estimation.fit.quadratic_program import Constraints, solve_step
from piezod.excitation import varying_triangles
from piezod.operators import EPS, PrandtlIshlinskii
from piezod.operators.dead_zone import inverse_dead_zone
from tests.benchmarks.rounds import ROUNDS, alternate
from tests.benchmarks.table import Row

Array = np.ndarray
Solver = Callable[[Array, Constraints], Array]

SIZES = ((15, 3), (50, 8), (180, 18))  # plays and dead zones: 20, 60 and 200 variables
U_MAX, Y_MAX = 140.0, 300.0


def measure(*, quick: bool) -> Iterator[Row]:
    """Two rows a solver and size: milliseconds, and the largest error of a slope."""
    for plays, zones in SIZES[: 2 if quick else 3]:
        gram, constraints, truth = known_program(plays, zones)
        found = {}
        for name, solver in solvers().items():
            try:
                found[name] = solver(gram, constraints)
            except (RecordingError, ValueError, RuntimeError) as error:
                yield Row("solvers", f"{gram.shape[0]} variables, {name}", note=f"not solved: {error}")
        times = alternate({name: _timed(solvers()[name], gram, constraints) for name in found}, ROUNDS)
        what = f"{gram.shape[0]} variables"
        for name, slopes in found.items():
            note = f"largest error of a slope {np.abs(slopes - truth).max():.1e}"
            limit = None if name == "ProxQP" else times["ProxQP"]
            yield Row("solvers", f"{what}, {name}", "ms", float(times[name]), limit, "ProxQP", note=note)


def known_program(plays: int, zones: int) -> tuple[Array, Constraints, Array]:
    """Gram matrix, constraints and true slopes of a known model."""
    rng = np.random.default_rng(plays)
    thresholds = play_thresholds(plays, 0.5 * U_MAX)
    weights = np.concatenate(([0.5], rng.uniform(0.0, 1.5 / plays, plays)))
    weights /= np.sum(weights * (1.0 - thresholds / U_MAX))
    zone_thresholds = dead_zone_thresholds(zones, 0.0, Y_MAX)
    zone_slopes = 0.45 + rng.uniform(-0.2, 0.2, zone_thresholds.size)
    direct = inverse_dead_zone(zone_thresholds, np.diff(zone_slopes, prepend=0.0))
    u = varying_triangles(U_MAX, 0.1, 2 * plays + 1, 100.0)
    y = PrandtlIshlinskii(thresholds, weights, *direct).run(u)
    structure = Structure(thresholds, zone_thresholds, 0.0, U_MAX, U_MAX / Y_MAX)
    gram = accumulate_gram(structure, pieces_of(structure, [Samples(u, y, np.ones(u.size, bool))]))
    constraints = Constraints.of(structure, 0, variant="B", eps=EPS)
    return gram, constraints, np.concatenate((np.cumsum(weights), [0.0], zone_slopes))


def by_proxqp(gram: Array, constraints: Constraints) -> Array:
    """Slopes by the program of the identification."""
    nothing = np.zeros(gram.shape[0])
    return solve_step(gram, nothing, constraints, nothing)


def solvers() -> dict[str, Solver]:
    """The installed solvers."""
    found: dict[str, Solver] = {"ProxQP": by_proxqp, "nnls": by_nnls}
    with contextlib.suppress(ImportError):
        import quadprog

        found["quadprog"] = lambda gram, constraints: by_quadprog(quadprog, gram, constraints)
    with contextlib.suppress(ImportError):
        import osqp

        found["OSQP to 1e-9"] = lambda gram, constraints: by_osqp(osqp, gram, constraints, 1e-9)
        found["OSQP to 1e-5"] = lambda gram, constraints: by_osqp(osqp, gram, constraints, 1e-5)
    return found


def scaled(gram: Array, constraints: Constraints) -> tuple[Array, Array, Array, Array]:
    """Scale, Hessian, all rows with the equality first, and their sides, as the quadratic program scales them."""
    scale = 1.0 / np.sqrt(np.diag(gram))
    hessian = gram * np.outer(scale, scale)
    rows = np.vstack((constraints.equality, constraints.rows)) * scale
    length = np.linalg.norm(rows, axis=1)
    sides = np.concatenate(([1.0], constraints.low)) / length
    return scale, hessian * gram.shape[0] / np.trace(hessian), rows / length[:, None], sides


def by_quadprog(quadprog, gram: Array, constraints: Constraints) -> Array:
    """Goldfarb and Idnani's dual method; a small diagonal makes the matrix positive definite."""
    scale, hessian, rows, sides = scaled(gram, constraints)
    hessian = hessian + 1e-13 * np.eye(hessian.shape[0])
    solution = quadprog.solve_qp(hessian, np.zeros(hessian.shape[0]), rows.T.copy(), sides, 1)
    return scale * solution[0]


def by_osqp(osqp, gram: Array, constraints: Constraints, tolerance: float) -> Array:
    """Operator splitting to an absolute tolerance on the scaled program, polished."""
    from scipy import sparse

    scale, hessian, rows, sides = scaled(gram, constraints)
    solver = osqp.OSQP()
    solver.setup(
        sparse.csc_matrix(np.triu(hessian)),
        np.zeros(hessian.shape[0]),
        sparse.csc_matrix(rows),
        sides,
        np.concatenate((sides[:1], np.full(sides.size - 1, np.inf))),
        verbose=False,
        eps_abs=tolerance,
        eps_rel=0.0,
        max_iter=20_000,
        polishing=True,
    )
    result = solver.solve(raise_error=False)
    if result.info.status != "solved":
        raise RuntimeError(result.info.status)
    return scale * result.x


def by_nnls(gram: Array, constraints: Constraints) -> Array:
    """Lawson and Hanson on a root of the Hessian, the equality a heavy row, the free constant a difference of two."""
    scale, hessian, rows, sides = scaled(gram, constraints)
    values, vectors = np.linalg.eigh(hessian)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    low = np.zeros(scale.size)
    bounded = np.flatnonzero(np.abs(constraints.rows).sum(axis=0) > 0)
    low[bounded] = constraints.low / scale[bounded]
    heavy = 1e6
    matrix = np.vstack((root, heavy * rows[0]))
    free = np.setdiff1d(np.arange(scale.size), bounded)
    target = np.concatenate((-root @ low, [heavy * (sides[0] - rows[0] @ low)]))
    solution = nnls(np.hstack((matrix, -matrix[:, free])), target, maxiter=100 * scale.size)[0]
    slopes = solution[: scale.size] + low
    slopes[free] -= solution[scale.size :]
    return scale * slopes


def _timed(solver: Solver, gram: Array, constraints: Constraints) -> Callable[[], float]:
    def once() -> float:
        begun = perf_counter_ns()
        solver(gram, constraints)
        return (perf_counter_ns() - begun) * 1e-6

    return once
