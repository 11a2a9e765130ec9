"""Robust Gauss-Newton fit of base and effects together, with the leave-one-block-out losses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.hypothesis.basis import HATS, SPLINES
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.layout import Layout, scaled, step_of, unscaled
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.estimation.fit.blocks import solved, spread

MOST_STEPS = 14
REUSES, MOST_FALL = 2, 0.01
"""Derivatives serve for two further steps once a step lowers the loss by less than 1 %. With 30 % a fit of a base with
two effects ended at 1.15 of the noise instead of 0.70."""
DONE = 1e-5  # relative fall of the loss below which a fit ends
FIRST_DAMPING, MOST_DAMPING = 1e-4, 1e4  # after a step that did not help
HUBER = 3.0  # [standard deviations] larger residuals count linearly (Huber 1964)
SMOOTH = 1e-10  # weight of second differences of density and force law, relative to the mean diagonal


@dataclass(frozen=True)
class Fitted:
    """A fitted hypothesis.

    Parameters
    ----------
    terms, point
        Effects of the hypothesis, and all parameters.
    losses
        Leave-one-block-out loss of every block, by one linear step: mean square residual [noise variance], shape (B,).
    in_fit
        Mean square residual of every block in the fit [noise variance], shape (B,).
    samples
        Weighted number of samples in every block, shape (B,).
    spread
        Standard errors of the searched parameters of each term, on their scale, by the jackknife over blocks.
    """

    terms: tuple[Term, ...]
    point: Point
    losses: Array
    in_fit: Array
    samples: Array
    spread: tuple[dict[str, float], ...]

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, each once, in the order of the search."""
        return tuple(dict.fromkeys(term.effect.name for term in self.terms))

    @property
    def loss(self) -> float:
        """Mean leave-one-block-out loss over all samples [noise variance]."""
        return float(self.losses @ self.samples / self.samples.sum())


def fit(
    chain: Chain, terms: Sequence[Term], start: Point, *, most_steps: int = MOST_STEPS, robust: bool = True
) -> Fitted:
    """Fit a hypothesis from a start; it ends early where the time of the chain is over.

    Parameters
    ----------
    chain
        Recordings and base.
    start
        Parameters to begin from.
    most_steps
        Largest number of Gauss-Newton steps.
    robust
        Whether large residuals count linearly. Not while the misfit is large: a strong effect would be an outlier.
    """
    layout = Layout(chain, terms)
    vector, damping = layout.vector(start), 1e-8
    current = Normal.at(chain, terms, layout.point(vector, start), robust=robust)
    steps, age = 0, 0  # age: of the derivatives, which change little from step to step
    while steps < most_steps and damping < MOST_DAMPING and not chain.is_late:
        trial = _step_within(layout, vector, current, damping)
        beyond = current.loss_at(layout.point(trial, start))
        if beyond < current.loss:
            fell = (current.loss - beyond) / current.loss
            vector, damping, steps = trial, max(damping * 0.1, 1e-12), steps + 1
            is_done = fell < DONE and not age
            age = age + 1 if age < REUSES and DONE < fell < MOST_FALL else 0
            current = Normal.at(chain, terms, layout.point(vector, start), current if age else None, robust=robust)
            if is_done:
                break
        elif age:
            age, current = 0, Normal.at(chain, terms, layout.point(vector, start), robust=robust)
        else:
            damping = max(10.0 * damping, FIRST_DAMPING)
    if age:
        current = Normal.at(chain, terms, layout.point(vector, start), robust=robust)
    return current.fitted()


def _step_within(layout: Layout, vector: Array, current: "Normal", damping: float) -> Array:
    """Step within all ranges: a parameter stops at the end of its range, and the step of the others is solved again."""
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
    compared: list[Array]  # simulated readings of the compared samples, one array per recording
    jacobians: list[Array]  # (N, P) per noise, 0 where a reading does not count
    tangents: list[Array]  # (N, columns) of `Chain.tangents`
    trust: list[Array]  # weights of the readings, 0 to 1
    weighted: list[Array]  # residuals times the robust weights
    weights: list[Array]  # robust weights
    hessian: Array  # (B, P, P)
    gradient: Array  # (B, P)
    squares: Array  # (B,) plain squares
    samples: Array  # (B,)
    counting: NDArray[np.bool_]  # (B,) whether the block counts
    loss: float  # Huber's loss with the penalties
    scales: list[float]  # robust standard deviation of the residuals [noise], one per recording
    stiff: Array  # (P,) curvature of the ridge penalties
    ridge: Array  # (P, P) curvature of all penalties
    pull: Array  # (P,) gradient of the ridge penalties

    @classmethod
    def at(
        cls, chain: Chain, terms: Sequence[Term], point: Point, near: "Normal | None" = None, *, robust: bool = True
    ) -> "Normal":
        """Normal equations of a hypothesis at a point; `near` lends the derivatives of a near point."""
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
        hessian, gradient, squares, samples, counting = [], [], [], [], []
        for number, series in enumerate(chain.series):
            rows = chain.rows[number]
            if near is None:
                tangents = chain.tangents(number, terms, point)
                reading, jacobian = _jacobian(chain, terms, point, layout, number, tangents)
                residual, trust = series.residual(rows, reading)
                jacobian *= trust[:, None] / series.noise_N
            else:
                tangents, jacobian = near.tangents[number], near.jacobians[number]
                reading = chain.compared(number, terms, point)
                residual, trust = series.residual(rows, reading)
            weights = series.weights(rows)
            made.trust.append(trust)
            scale = max(1.4826 * float(np.median(np.abs(residual[trust > 0.0]))), 1e-6) if robust else np.inf
            weight = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-12))
            made.loss += _robust(residual, scale)
            made.scales.append(scale)
            made.compared.append(reading)
            made.jacobians.append(jacobian)
            made.tangents.append(tangents)
            made.weighted.append(weight * residual)
            made.weights.append(weight)
            for stretch, block in zip(series.blocks, thinned(series.blocks, rows.step), strict=True):
                part = jacobian[block]
                if near is None:
                    hessian.append(_weighted_square(part, weight[block]))
                gradient.append(part.T @ made.weighted[-1][block])
                squares.append(float(residual[block] @ residual[block]))
                samples.append(float(weights[block] @ weights[block]))
                counting.append(series.block_counts(stretch))
        made.hessian, made.gradient = np.array(hessian) if near is None else near.hessian, np.array(gradient)
        made.squares, made.samples, made.counting = np.array(squares), np.array(samples), np.array(counting)
        made.stiff, vector = layout.stiffness(float(made.samples.sum())), layout.vector(point)
        made.ridge, made.pull = _ridge(made.hessian, layout) + np.diag(made.stiff), -made.stiff * vector
        made.loss += float(made.stiff @ vector**2)
        return made

    def readings(self) -> list[Array]:
        """Simulated readings of all samples, an array of shape (N,) per recording [N]."""
        return [self.chain.run(number, self.terms, self.point).reading_N for number in range(len(self.chain.series))]

    def loss_at(self, point: Point) -> float:
        """Huber's loss with the penalties at another point."""
        vector = self.layout.vector(point)
        loss = float(self.stiff @ vector**2)
        for number, series in enumerate(self.chain.series):
            residual, _ = series.residual(self.chain.rows[number], self.chain.compared(number, self.terms, point))
            loss += _robust(residual, self.scales[number])
        return loss if np.isfinite(loss) else np.inf

    def step(self, damping: float, held: Array) -> Array:
        """Levenberg-Marquardt step, shape (P,); a parameter whose `held` is not nan moves by that amount."""
        hessian = self.hessian.sum(axis=0) + self.ridge
        hessian += damping * np.diag(np.diag(hessian))
        free, step = np.isnan(held), np.nan_to_num(held)
        side = self.gradient.sum(axis=0) + self.pull - hessian @ step
        step[free] = solved(hessian[np.ix_(free, free)], side[free])
        return step

    def projected(self, columns: Sequence[Array]) -> tuple[Array, Array, Array]:
        """Normal equations of further columns, with the fitted parameters projected off.

        Parameters
        ----------
        columns
            Columns of the compared readings, an array of shape (rows, K) per recording [N].

        Returns
        -------
        tuple
            Hessian, shape (K, K); gradient, shape (K,); square of each column before the projection, shape (K,).
        """
        count = columns[0].shape[1]
        across, inner, along = np.zeros((self.ridge.shape[0], count)), np.zeros((count, count)), np.zeros(count)
        for number, series in enumerate(self.chain.series):
            scaled = columns[number] * (self.trust[number] / series.noise_N)[:, None]
            weighted = self.weights[number][:, None] * scaled
            across += self.jacobians[number].T @ weighted
            inner += scaled.T @ weighted
            along += scaled.T @ self.weighted[number]
        hessian, gradient = self.hessian.sum(axis=0) + self.ridge, self.gradient.sum(axis=0) + self.pull
        fitted = solved(hessian, across)
        return inner - across.T @ fitted, along - fitted.T @ gradient, np.diag(inner)

    def free_energy(self, change: Sequence[Array | None]) -> float:
        """Square of the part of a change that the fitted parameters cannot follow [noise variance].

        Parameters
        ----------
        change
            Change of the compared readings: an array of shape (rows,) per recording [N], or None for no change.
        """
        across, inner = np.zeros(self.ridge.shape[0]), 0.0
        for number, change_N in enumerate(change):
            if change_N is not None:
                series = self.chain.series[number]
                scaled = change_N * self.trust[number] / series.noise_N
                weighted = self.weights[number] * scaled
                across += self.jacobians[number].T @ weighted
                inner += float(scaled @ weighted)
        return inner - float(solved(self.hessian.sum(axis=0) + self.ridge, across) @ across)

    def left_out_moves(self, held: Array | None = None) -> Array:
        """Change of the fitted vector when a block is left out, shape (B, P), by one linear step.

        A weak prior holds a parameter that one block alone determines. A parameter whose `held` is not nan stays.
        """
        hessian = self.hessian.sum(axis=0) + self.ridge + self.layout.prior(self.chain, self.point)
        gradient = self.gradient.sum(axis=0) + self.pull
        free = np.full(gradient.size, True) if held is None else np.isnan(held)
        moves, within = np.zeros(self.gradient.shape), np.ix_(free, free)
        for move, block, side in zip(moves, self.hessian, self.gradient, strict=True):
            move[free] = solved((hessian - block)[within], (gradient - side)[free])
        return moves

    def fitted(self) -> Fitted:
        """Fit with the leave-one-block-out losses, by one linear step."""
        moves = self.left_out_moves()
        losses = np.array(
            [
                square - 2.0 * move @ side + move @ block @ move
                for square, move, side, block in zip(self.squares, moves, self.gradient, self.hessian, strict=True)
            ]
        )
        jackknife = np.sqrt(np.diag(spread(moves)))
        errors: tuple[dict[str, float], ...] = tuple({} for _ in self.terms)
        for place, (term, parameter) in enumerate(self.layout.searched, start=self.layout.effects):
            errors[term][parameter.name] = float(jackknife[place])
        counted = np.where(self.counting, self.samples, 0.0)
        samples = np.maximum(self.samples, 1.0)
        left_out = np.where(self.counting, np.maximum(losses, 1e-12), 1e-12) / samples
        return Fitted(self.terms, self.point, left_out, self.counting * self.squares / samples, counted, errors)


def _jacobian(
    chain: Chain, terms: Sequence[Term], point: Point, layout: Layout, number: int, tangents: Array
) -> tuple[Array, Array]:
    """Compared readings of a recording, shape (rows,) [N], and their derivatives, shape (rows, P)."""
    series = chain.series[number]
    compared_N = chain.compared(number, terms, point)
    jacobian = np.zeros((compared_N.size, layout.size), order="F")  # it is filled and read by columns
    jacobian[:, layout.carried] = tangents
    if number:
        jacobian[:, layout.offsets + number - 1] = 1.0
    for place, (term, parameter) in enumerate(layout.searched, start=layout.effects):
        if place not in layout.carried and terms[term].acts_on(number, series):
            value = scaled(parameter, point.values[term][parameter.name])
            size = step_of(parameter, value)
            moved = _moved(point, term, parameter.name, unscaled(parameter, value + size))
            change = chain.compared(number, terms, moved) - compared_N
            jacobian[:, place] = change / size
    return compared_N, jacobian


def _weighted_square(rows: Array, weights: Array) -> Array:
    """Sum of w j j^T over rows j. Few weights differ from 1, so the plain square is corrected for those."""
    few = np.flatnonzero(weights != 1.0)
    square: Array = rows.T @ rows
    if few.size:
        square -= rows[few].T @ ((1.0 - weights[few])[:, None] * rows[few])
    return square


def thinned(blocks: Sequence[slice], step: int) -> list[slice]:
    """Blocks in a record of every `step`-th sample."""
    return [slice(-(-block.start // step), -(-block.stop // step)) for block in blocks]


def _robust(residual: Array, scale: float) -> float:
    """Huber's loss."""
    if np.isinf(scale):
        return float(residual @ residual)
    size, limit = np.abs(residual), HUBER * scale
    return float(np.sum(np.where(size <= limit, size * size, limit * (2.0 * size - limit))))


def _moved(point: Point, term: int, name: str, value: float) -> Point:
    values = tuple({**known, name: value} if number == term else known for number, known in enumerate(point.values))
    return replace(point, values=values)


def _ridge(blocks: Array, layout: Layout) -> Array:
    """Penalty of the second differences of density and force law, for columns that no sample determines."""
    size = blocks.shape[1]
    diagonal = np.einsum("bii->i", blocks)
    ridge = np.diag(1e-12 * diagonal + 1e-12)
    for first, count in ((0, HATS), (layout.plays, SPLINES)):
        bends = np.diff(np.eye(count), 2, axis=0)
        mean = diagonal[first : first + count].mean()
        ridge[first : first + count, first : first + count] += SMOOTH * mean * bends.T @ bends
    assert ridge.shape == (size, size)
    return ridge
