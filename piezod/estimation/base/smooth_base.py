"""The smooth base: a fine grid of plays before a fine force law, with penalties for roughness.

    minimise e'e + a |D2 play slopes|^2 + b |D2 force slopes|^2   subject to   slopes >= eps,   H(u_max) = u_max

D2 are second differences from threshold to threshold. The weights a and b minimise the error on held-out bands of the
input. A slope that no sample determines equals its neighbours. Each Gauss-Newton step is a quadratic program, solved by
ProxQP.

Source of the penalty: Eilers and Marx (1996), Flexible smoothing with B-splines and penalties, Statistical Science
11(2), 89-121.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.estimation.fit.blocks import Blocks
from piezod.estimation.fit.columns import Samples, Structure, clocks_of
from piezod.estimation.fit.normal_equations import Piece, merged, pieces_of, sums_of
from piezod.estimation.fit.quadratic_program import Constraints, minimise, penalised_step, solve_step

WEIGHTS = 10.0 ** np.arange(-9.0, 2.0)
"""Tried weights of the penalties, relative to the trace of the Hessian of the data."""

FIRST_WEIGHTS = (1e-4, 1e-2)
"""Weights of plays and force law for the first fit: the middle of the selected ones on concealed plants."""

CONTINUES = 1e-9
"""Weight of first differences, which fixes the undetermined slopes: below the data's part, above rounding."""

MOST_STEPS = 15
ENOUGH = 1e-6  # share of the squared error by which a further step must be expected to lower it
MOST_ROWS = 100_000
"""Rows in the sums of the steps. A longer recording is averaged to so many; the last step sums over every sample."""


@dataclass(frozen=True)
class Base:
    """A fit with its normal equations."""

    structure: Structure
    zones: Array  # thresholds of the force law, shape (m + 1,), from 0 [input unit]
    parameters: Array  # p: play slopes, a constant, drifts, slopes of the force law, shape (q,)
    sums: Blocks  # normal equations at the parameters, over every sample
    penalty: Array  # shape (q, q) [output unit^2]; the fit minimises loss + p' penalty p
    constraints: Constraints
    eps: float  # smallest slope, see `fit_smooth_base`

    def without(self, group: int) -> Array:
        """Parameters of the fit without a group of bands, shape (q,), within the bounds."""
        gram, side = self.sums.rest([group])
        pull = -self.penalty @ self.parameters
        return solve_step(gram + self.penalty, side + pull, self.constraints, self.parameters)


def fit_smooth_base(structure: Structure, zones: Array, recordings: Sequence[Samples], eps: float) -> Base:
    """Fit recordings by the smooth base; long recordings are averaged to `MOST_ROWS` rows.

    Parameters
    ----------
    structure, zones
        Fine thresholds of the plays, and of the force law from 0, shape (m + 1,) [input unit].
    eps
        Smallest slope, as a fraction of the mean slope of the plays and of the steepest slope of the force law.

    Raises
    ------
    RecordingError
        The quadratic program was not solved.
    """
    start = straight_line(structure, zones, recordings)
    return _fitted(structure, zones, recordings, eps, start, None)[0]


def fit_roughly(structure: Structure, zones: Array, recordings: Sequence[Samples], eps: float, every: int) -> Base:
    """Fit with a row for `every` samples and a fixed penalty, to compare starts; else as `fit_smooth_base`."""
    pieces = merged(pieces_of(structure, recordings, every))
    solver = _Solver(structure, zones, clocks_of(recordings), eps)
    return solver.first_fit(pieces, straight_line(structure, zones, recordings))


def refit(
    structure: Structure, zones: Array, recordings: Sequence[Samples], eps: float, start: Array, penalty: Array
) -> Base:
    """Fit to every sample with a penalty, shape (q, q), from a start, shape (q,); else as `fit_smooth_base`."""
    base, solver, every = _fitted(structure, zones, recordings, eps, start, penalty)
    return base if every == 1 else solver.over_all(lambda: pieces_of(structure, recordings), base)


def base_at(
    structure: Structure, zones: Array, recordings: Sequence[Samples], eps: float, parameters: Array, penalty: Array
) -> Base:
    """The smooth base with given parameters, shape (q,), and its sums over every sample; else as `refit`."""
    solver = _Solver(structure, zones, clocks_of(recordings), eps)
    return solver.base(parameters, sums_of(pieces_of(structure, recordings), structure, zones, parameters), penalty)


def _fitted(
    structure: Structure,
    zones: Array,
    recordings: Sequence[Samples],
    eps: float,
    start: Array,
    penalty: Array | None,
) -> "tuple[Base, _Solver, int]":
    """The fit, its solver, and the number of samples per row."""
    count = sum(int(np.count_nonzero(samples.counts)) for samples in recordings)
    every = max(1, -(-count // MOST_ROWS))
    pieces = merged(pieces_of(structure, recordings, every))
    solver = _Solver(structure, zones, clocks_of(recordings), eps)
    if penalty is None:
        base = solver.first_fit(pieces, start)
        start, penalty = base.parameters, solver.chosen_penalty(base)
    return solver.fit(pieces, start, penalty), solver, every


def straight_line(structure: Structure, zones: Array, recordings: Sequence[Samples]) -> Array:
    """Parameters of a straight line without hysteresis from the lowest to the highest output, shape (q,)."""
    low_V = min(float(samples.u.min()) for samples in recordings)
    high_V = max(float(samples.u.max()) for samples in recordings)
    known = [samples.y[samples.counts] for samples in recordings]
    low, high = min(float(y.min()) for y in known), max(float(y.max()) for y in known)
    gain = (high - low) / (high_V - low_V)
    drifts = np.zeros(clocks_of(recordings))
    return np.concatenate((np.ones(structure.plays), [-low_V], drifts, np.full(zones.size, gain)))


class _Solver:
    """Gauss-Newton steps for one structure."""

    def __init__(self, structure: Structure, zones: Array, clocks: int, eps: float) -> None:
        self._structure, self._zones, self._eps = structure, zones, eps
        self._constraints = Constraints.of(structure, clocks, variant="B", eps=eps)
        self._count = structure.plays + 1 + clocks + zones.size
        self._tables = slice(0, structure.plays), slice(self._count - zones.size, self._count)

    def fit(self, pieces: Sequence[Piece], start: Array, penalty: Array) -> Base:
        """Base with the least penalised error over the pieces."""

        def sums_at(parameters: Array) -> Blocks:
            return sums_of(pieces, self._structure, self._zones, parameters)

        return self.base(*minimise(sums_at, self._bounds, start, penalty, ENOUGH, MOST_STEPS), penalty)

    def over_all(self, pieces: Callable[[], Iterable[Piece]], base: Base) -> Base:
        """The base after another step with the sums over every sample."""
        sums = sums_of(pieces(), self._structure, self._zones, base.parameters)
        bounds = self._bounds(base.parameters)
        better = base.parameters + penalised_step(sums, bounds, base.penalty, base.parameters)
        return self.base(better, sums_of(pieces(), self._structure, self._zones, better), base.penalty)

    def base(self, parameters: Array, sums: Blocks, penalty: Array) -> Base:
        """A base from parameters and their sums."""
        return Base(self._structure, self._zones, parameters, sums, penalty, self._bounds(parameters), self._eps)

    def _bounds(self, parameters: Array) -> Constraints:
        steepest = float(parameters[self._tables[1]].max())
        return self._constraints.for_direct(self._zones.size, self._eps * steepest)

    def first_fit(self, pieces: Sequence[Piece], start: Array) -> Base:
        """Base with the penalty of `FIRST_WEIGHTS`."""
        sums = sums_of(pieces, self._structure, self._zones, start)
        return self.fit(pieces, start, self._weighted(sums, FIRST_WEIGHTS))

    def _weighted(self, sums: Blocks, weights: tuple[float, float]) -> Array:
        """Penalty with weights relative to the Hessian of the data, shape (q, q)."""
        (gram, _), result = sums.total, np.zeros((self._count, self._count))
        for part, weight in zip(self._tables, weights, strict=True):
            power = float(np.trace(gram[part, part]))
            identity = np.eye(part.stop - part.start)
            for order, share in ((2, weight), (1, CONTINUES)):
                if identity.shape[0] > order:
                    differences = np.diff(identity, order, axis=0)
                    result[part, part] += power * share * differences.T @ differences
        return result

    def chosen_penalty(self, base: Base) -> Array:
        """Penalty with the least held-out error over all groups of bands."""
        weights = [FIRST_WEIGHTS[0], FIRST_WEIGHTS[1]]
        for table in (0, 1, 0, 1):
            losses = []
            for weight in WEIGHTS:
                weights[table] = float(weight)
                losses.append(self.held_out_loss(base, self._weighted(base.sums, (weights[0], weights[1]))))
            weights[table] = float(WEIGHTS[int(np.argmin(losses))])
        return self._weighted(base.sums, (weights[0], weights[1]))

    def held_out_loss(self, base: Base, penalty: Array) -> float:
        """Squared error over all groups, each predicted by a fit of the other groups without the bounds."""
        equality = self._constraints.equality
        assert equality is not None
        free = np.linalg.svd(equality[None, :])[2][1:].T
        reduced, pull = base.sums.along(free), -penalty @ base.parameters
        return float(reduced.errors(reduced.without(free.T @ penalty @ free, pull @ free)).sum())
