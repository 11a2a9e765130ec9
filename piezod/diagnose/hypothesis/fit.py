"""Robust Gauss-Newton over base and effects together, and what each block of a recording says when it is left out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import HATS, SPLINES, Chain, Point, Term
from piezod.diagnose.hypothesis.layout import Layout, scaled, step_of, unscaled

Array = NDArray[np.float64]

MOST_STEPS = 14
REUSED, SETTLED = 2, 0.3  # how often tangents serve again after steps that change the loss less than this
DONE = 1e-5  # relative fall of the loss below which a fit ends
FIRST_DAMPING, MOST_DAMPING = 1e-4, 1e4  # after a step that did not help
HUBER = 3.0  # residuals beyond so many standard deviations count less
SMOOTH = 1e-10  # weight of the density's and the law's bends, in parts of the mean diagonal


@dataclass(frozen=True)
class Fitted:
    """A hypothesis and how well it fits.

    Parameters
    ----------
    terms, point
        The hypothesis and its parameters.
    losses
        Mean square residual of every block in units of its recording's noise, the block left out of the fit (by one
        linear step), shape (B,).
    in_fit
        The same with the block in the fit, shape (B,).
    samples
        How many samples of every block count, each as far as it is trusted, shape (B,).
    spread
        Standard errors of the searched parameters on their scale, from the curvature and the blocks' scatter.
    """

    terms: tuple[Term, ...]
    point: Point
    losses: Array
    in_fit: Array
    samples: Array
    spread: tuple[dict[str, float], ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Their names, each once, in the order of the search."""
        return tuple(dict.fromkeys(term.effect.name for term in self.terms))

    @property
    def loss(self) -> float:
        """Mean over all samples."""
        return float(self.losses @ self.samples / self.samples.sum())


def fit(chain: Chain, terms: Sequence[Term], start: Point, *, most_steps: int = MOST_STEPS) -> Fitted:
    """Fit a hypothesis from a start.

    Parameters
    ----------
    chain
        Recordings and base.
    terms
        Effects.
    start
        Where to begin.
    most_steps
        Of Gauss-Newton.
    """
    layout = Layout(chain, terms)
    vector, damping = layout.vector(start), 1e-8
    current = Normal.at(chain, terms, layout.point(vector, start))
    steps, age = 0, 0  # age: of the tangents, which change little from step to step
    while steps < most_steps and damping < MOST_DAMPING:
        trial = _within(layout, vector, current, damping)
        beyond = current.loss_at(layout.point(trial, start))
        if beyond < current.loss:
            fell = (current.loss - beyond) / current.loss
            vector, damping, steps = trial, max(damping * 0.1, 1e-12), steps + 1
            age = age + 1 if age < REUSED and fell < SETTLED else 0
            current = Normal.at(chain, terms, layout.point(vector, start), current if age else None)
            if fell < DONE:
                if not age:
                    break
                age = REUSED
        elif age:
            age, current = 0, Normal.at(chain, terms, layout.point(vector, start))
        else:
            damping = max(10.0 * damping, FIRST_DAMPING)
    if age:
        current = Normal.at(chain, terms, layout.point(vector, start))
    return current.fitted(layout.point(vector, start))


def _within(layout: Layout, vector: Array, current: "Normal", damping: float) -> Array:
    """A step that stays in every range: what would leave it stops at its end, and the others are solved for anew."""
    held = np.full(vector.size, np.nan)
    for _ in range(vector.size - layout.effects + 1):
        trial: Array = vector + current.step(damping, held)
        inside = layout.clipped(trial)
        leaving = np.abs(inside - trial) > 1e-12 * (1.0 + np.abs(inside))
        if not leaving.any():
            break
        held[leaving] = (inside - vector)[leaving]
    return layout.clipped(trial)


@dataclass
class Normal:
    """Normal equations of a hypothesis at a point, block by block; residuals in units of each recording's noise."""

    chain: Chain
    terms: tuple[Term, ...]
    point: Point
    layout: Layout
    compared: list[Array]  # simulated, of the samples that are compared, one a recording
    jacobians: list[Array]  # (N, P), 0 where a reading does not count
    tangents: list[Array]  # (N, base and effects' weights), as they are simulated
    told: list[Array]  # weights of the readings that tell
    weighted: list[Array]  # residuals times the robust weights
    weights: list[Array]
    hessian: Array  # (B, P, P)
    gradient: Array  # (B, P)
    squares: Array  # (B,) plain squares
    samples: Array  # (B,)
    judged: NDArray[np.bool_]  # (B,) whether the block tells of a hypothesis
    loss: float  # robust
    scales: list[float]
    stiff: Array  # curvature that draws stiff parameters to zero
    ridge: Array
    pull: Array  # towards zero, of stiff parameters

    @classmethod
    def at(cls, chain: Chain, terms: Sequence[Term], point: Point, near: "Normal | None" = None) -> "Normal":
        """Normal equations of a hypothesis at a point, with the tangents of one that is near or its own."""
        layout = Layout(chain, terms)
        none = np.empty(0)
        made = cls(
            chain,
            tuple(terms),
            point,
            layout,
            [],
            [],
            [],
            [],
            [],
            [],
            none,
            none,
            none,
            none,
            np.empty(0, bool),
            0.0,
            [],
            none,
            none,
            none,
        )
        hessian, gradient, squares, samples, judged = [], [], [], [], []
        for number, series in enumerate(chain.series):
            tangents = chain.tangents(number, terms, point) if near is None else near.tangents[number]
            reading, jacobian = _jacobian(chain, terms, point, layout, number, tangents)
            rows = chain.rows[number]
            residual, told = series.residual(rows, reading)
            jacobian *= told[:, None] / series.noise_N
            trusted = series.weights(rows)
            made.told.append(told)
            scale = max(1.4826 * float(np.median(np.abs(residual[told > 0.0]))), 1e-6)
            weight = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-12))
            made.loss += _robust(residual, scale)
            made.scales.append(scale)
            made.compared.append(reading)
            made.jacobians.append(jacobian)
            made.tangents.append(tangents)
            made.weighted.append(weight * residual)
            made.weights.append(weight)
            for whole, block in zip(series.blocks, _thinned(series.blocks, rows.step), strict=True):
                part = jacobian[block]
                hessian.append(_weighted_square(part, weight[block]))
                gradient.append(part.T @ made.weighted[-1][block])
                squares.append(float(residual[block] @ residual[block]))
                samples.append(float(trusted[block] @ trusted[block]))
                judged.append(series.judges(whole))
        made.hessian, made.gradient = np.array(hessian), np.array(gradient)
        made.squares, made.samples, made.judged = np.array(squares), np.array(samples), np.array(judged)
        made.stiff, vector = layout.stiffness(float(made.samples.sum())), layout.vector(point)
        made.ridge, made.pull = _ridge(made.hessian, layout) + np.diag(made.stiff), -made.stiff * vector
        made.loss += float(made.stiff @ vector**2)
        return made

    def readings(self) -> list[Array]:
        """Simulated readings of all samples, one array a recording, shape (N,) [N]."""
        return [self.chain.run(number, self.terms, self.point).reading_N for number in range(len(self.chain.series))]

    def loss_at(self, point: Point) -> float:
        """The robust loss alone, at another point."""
        vector = self.layout.vector(point)
        loss = float(self.stiff @ vector**2)
        for number, series in enumerate(self.chain.series):
            residual, _ = series.residual(self.chain.rows[number], self.chain.compared(number, self.terms, point))
            loss += _robust(residual, self.scales[number])
        return loss if np.isfinite(loss) else np.inf

    def step(self, damping: float, held: Array) -> Array:
        """Levenberg's and Marquardt's step; parameters that are `held` (not nan) move by just that."""
        hessian = self.hessian.sum(axis=0) + self.ridge
        hessian += damping * np.diag(np.diag(hessian))
        free, step = np.isnan(held), np.nan_to_num(held)
        side = self.gradient.sum(axis=0) + self.pull - hessian @ step
        step[free] = solved(hessian[np.ix_(free, free)], side[free])
        return step

    def gain_of(self, changes: Sequence[Sequence[Array | None]]) -> tuple[float, Array]:
        """Fall of the squared residual when multiples of changes are fitted with everything else, and the multiples.

        Parameters
        ----------
        changes
            Of the readings that are compared, for every recording, shape (rows,), or None where nothing changes [N].
            One that what is fitted follows by itself has the size 0.
        """
        count = len(changes)
        columns = []
        for number in range(len(self.chain.series)):
            acting = [change[number] for change in changes]
            size = self.told[number].size
            columns.append(np.array([np.zeros(size) if one is None else one for one in acting]).T)
        free, along, squares = self.projected(columns)
        sizes = np.zeros(count)
        own = np.diag(free) > 1e-9 * squares
        if own.any():
            sizes[own] = solved(free[np.ix_(own, own)], along[own])
        return float(along[own] @ sizes[own]), sizes

    def projected(self, columns: Sequence[Array]) -> tuple[Array, Array, Array]:
        """Normal equations of further columns, everything that is fitted projected off.

        Parameters
        ----------
        columns
            Of the readings that are compared, for every recording, shape (rows, K) [N].

        Returns
        -------
        tuple
            Of the columns with each other, shape (K, K), and with the residual, shape (K,); the square of each before,
            shape (K,).
        """
        count = columns[0].shape[1]
        across, inner, along = np.zeros((self.ridge.shape[0], count)), np.zeros((count, count)), np.zeros(count)
        for number, series in enumerate(self.chain.series):
            scaled = columns[number] * (self.told[number] / series.noise_N)[:, None]
            weighted = self.weights[number][:, None] * scaled
            across += self.jacobians[number].T @ weighted
            inner += scaled.T @ weighted
            along += scaled.T @ self.weighted[number]
        hessian, gradient = self.hessian.sum(axis=0) + self.ridge, self.gradient.sum(axis=0) + self.pull
        fitted = np.array([solved(hessian, column) for column in across.T]).T
        return inner - across.T @ fitted, along - fitted.T @ gradient, np.diag(inner)

    def free_energy(self, change: Sequence[Array | None]) -> float:
        """Square of a change of the readings, in units of the noise, that nothing which is fitted can follow.

        Parameters
        ----------
        change
            Of every recording, shape (rows,), or None where nothing changes [N].
        """
        across, inner = np.zeros(self.ridge.shape[0]), 0.0
        for number, one in enumerate(change):
            if one is not None:
                series = self.chain.series[number]
                scaled = one * self.told[number] / series.noise_N
                weighted = self.weights[number] * scaled
                across += self.jacobians[number].T @ weighted
                inner += float(scaled @ weighted)
        return inner - float(solved(self.hessian.sum(axis=0) + self.ridge, across) @ across)

    def fitted(self, point: Point) -> Fitted:
        """What every block says when it is left out, by one linear step.

        A parameter that one block alone determines stays within reason without it: a weak prior holds it.
        """
        hessian = self.hessian.sum(axis=0) + self.ridge + self.layout.prior(self.chain, point)
        gradient = self.gradient.sum(axis=0) + self.pull
        losses = np.empty(self.squares.size)
        moves = np.empty((self.squares.size, gradient.size))
        for b in range(losses.size):
            move = solved(hessian - self.hessian[b], gradient - self.gradient[b])
            moves[b] = move
            losses[b] = self.squares[b] - 2.0 * move @ self.gradient[b] + move @ self.hessian[b] @ move
        jackknife = np.sqrt((losses.size - 1) / losses.size * np.sum((moves - moves.mean(axis=0)) ** 2, axis=0))
        spread: tuple[dict[str, float], ...] = tuple({} for _ in self.terms)
        for place, (term, one) in enumerate(self.layout.searched, start=self.layout.effects):
            spread[term][one.name] = float(jackknife[place])
        counted = np.where(self.judged, self.samples, 0.0)
        samples = np.maximum(self.samples, 1.0)
        left_out = np.where(self.judged, np.maximum(losses, 1e-12), 1e-12) / samples
        return Fitted(self.terms, point, left_out, self.judged * self.squares / samples, counted, spread)


def _jacobian(
    chain: Chain, terms: Sequence[Term], point: Point, layout: Layout, number: int, tangents: Array
) -> tuple[Array, Array]:
    """Simulated readings of a recording that are compared, and how they change with every parameter."""
    series = chain.series[number]
    compared_N = chain.compared(number, terms, point)
    jacobian = np.zeros((compared_N.size, layout.size), order="F")  # it is filled and read by columns
    jacobian[:, layout.carried] = tangents
    if number:
        jacobian[:, layout.offsets + number - 1] = 1.0
    for place, (term, one) in enumerate(layout.searched, start=layout.effects):
        if place not in layout.carried and terms[term].acts_on(number, series):
            here = scaled(one, point.values[term][one.name])
            size = step_of(one, here)
            moved = _moved(point, term, one.name, unscaled(one, here + size))
            change = chain.compared(number, terms, moved) - compared_N
            jacobian[:, place] = change / size
    return compared_N, jacobian


def _weighted_square(rows: Array, weights: Array) -> Array:
    """Sum of w j j^T over rows j. Few weights are not 1, and a plain square is computed by half."""
    few = np.flatnonzero(weights != 1.0)
    square: Array = rows.T @ rows
    if few.size:
        square -= rows[few].T @ ((1.0 - weights[few])[:, None] * rows[few])
    return square


def _thinned(blocks: Sequence[slice], step: int) -> list[slice]:
    """The same blocks among every `step`-th sample."""
    return [slice(-(-block.start // step), -(-block.stop // step)) for block in blocks]


def _robust(residual: Array, scale: float) -> float:
    """Huber's loss."""
    size, limit = np.abs(residual), HUBER * scale
    return float(np.sum(np.where(size <= limit, size * size, limit * (2.0 * size - limit))))


def _moved(point: Point, term: int, name: str, value: float) -> Point:
    values = tuple({**one, name: value} if number == term else one for number, one in enumerate(point.values))
    return replace(point, values=values)


def _ridge(blocks: Array, layout: Layout) -> Array:
    """Keeps density and law from bending where no sample tells."""
    size = blocks.shape[1]
    diagonal = np.einsum("bii->i", blocks)
    ridge = np.diag(1e-12 * diagonal + 1e-12)
    for first, count in ((0, HATS), (layout.plays, SPLINES)):
        bends = np.diff(np.eye(count), 2, axis=0)
        mean = diagonal[first : first + count].mean()
        ridge[first : first + count, first : first + count] += SMOOTH * mean * bends.T @ bends
    assert ridge.shape == (size, size)
    return ridge


def solved(matrix: Array, side: Array) -> Array:
    """Of normal equations, each parameter scaled to its own curvature; zeros where there is no solution."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    try:
        result: Array = scale * np.linalg.solve(
            matrix * np.outer(scale, scale) + 1e-13 * np.eye(side.size), scale * side
        )
    except np.linalg.LinAlgError:
        result = np.zeros_like(side)
    return result
