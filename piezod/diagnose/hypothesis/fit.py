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
from piezod.estimation.fit.blocks import Blocks, solved, spread

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


@dataclass(frozen=True)
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
    blocks: Blocks  # sums with the robust weights; the squares are plain
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
        layout, loss = Layout(chain, terms), 0.0
        compared: list[Array] = []
        jacobians: list[Array] = []
        tangents: list[Array] = []
        trust: list[Array] = []
        weighted: list[Array] = []
        weights: list[Array] = []
        scales: list[float] = []
        grams, sums, counting = [], [], []
        for number, series in enumerate(chain.series):
            rows = chain.rows[number]
            if near is None:
                tangent = chain.tangents(number, terms, point)
                reading, jacobian = _jacobian(chain, terms, point, layout, number, tangent)
                residual, trusted = series.residual(rows, reading)
                jacobian *= trusted[:, None] / series.noise_N
            else:
                tangent, jacobian = near.tangents[number], near.jacobians[number]
                reading = chain.compared(number, terms, point)
                residual, trusted = series.residual(rows, reading)
            scale = max(1.4826 * float(np.median(np.abs(residual[trusted > 0.0]))), 1e-6) if robust else np.inf
            weight = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(residual), 1e-12))
            loss += _robust(residual, scale)
            scales.append(scale)
            compared.append(reading)
            jacobians.append(jacobian)
            tangents.append(tangent)
            trust.append(trusted)
            weighted.append(weight * residual)
            weights.append(weight)
            counts = series.weights(rows)
            for stretch, block in zip(series.blocks, thinned(series.blocks, rows.step), strict=True):
                if near is None:
                    grams.append(_weighted_square(jacobian[block], weight[block]))
                side = jacobian[block].T @ weighted[-1][block]
                sums.append((side, residual[block] @ residual[block], counts[block] @ counts[block]))
                counting.append(series.block_counts(stretch))
        gram = np.array(grams) if near is None else near.blocks.gram
        blocks = Blocks(gram, *(np.array(one) for one in zip(*sums, strict=True)))
        stiff, vector = layout.stiffness(float(blocks.samples.sum())), layout.vector(point)
        return cls(
            chain,
            tuple(terms),
            point,
            layout,
            compared,
            jacobians,
            tangents,
            trust,
            weighted,
            weights,
            blocks,
            np.array(counting),
            loss + float(stiff @ vector**2),
            scales,
            stiff,
            _ridge(gram, layout) + np.diag(stiff),
            -stiff * vector,
        )

    @property
    def total(self) -> tuple[Array, Array]:
        """Hessian, shape (P, P), and gradient, shape (P,), of all blocks and the penalties."""
        hessian, gradient = self.blocks.total
        return hessian + self.ridge, gradient + self.pull

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
        hessian, gradient = self.total
        return solved(hessian + damping * np.diag(np.diag(hessian)), gradient, held)

    def beside(self, columns: Sequence[Array]) -> tuple[Blocks, Array]:
        """Sums of the fitted columns with K further columns and the residual as targets, and the pull of the penalties.

        Parameters
        ----------
        columns
            Columns of the compared readings, an array of shape (rows, K) per recording [N].
        """
        sides, squares = [], []
        for number, series in enumerate(self.chain.series):
            scaled = columns[number] * (self.trust[number] / series.noise_N)[:, None]
            weighted = self.weights[number][:, None] * scaled
            for block in thinned(series.blocks, self.chain.rows[number].step):
                sides.append(self.jacobians[number][block].T @ weighted[block])
                rows = np.hstack((weighted[block], self.weighted[number][block, None]))
                squares.append(scaled[block].T @ rows)
        blocks, inner = self.blocks, np.array(squares)
        side = np.concatenate((np.array(sides), blocks.side[:, :, None]), axis=2)
        last = np.concatenate((inner[:, :, -1], blocks.square[:, None]), axis=1)
        pull = np.zeros(side.shape[1:])
        pull[:, -1] = self.pull
        return Blocks(blocks.gram, side, np.concatenate((inner, last[:, None, :]), axis=1), blocks.samples), pull

    def projected(self, columns: Sequence[Array]) -> tuple[Array, Array]:
        """Products of further columns and of the residual, with the fitted parameters projected off.

        Returns
        -------
        tuple
            Products, shape (K + 1, K + 1); square of each column before the projection, shape (K,).
        """
        sums, pull = self.beside(columns)
        squares = np.diag(sums.square.sum(axis=0))[:-1]
        return sums.left(sums.solve(penalty=self.ridge, pull=pull), pull), squares

    def left_out_moves(self, held: Array | None = None) -> Array:
        """Change of the fitted vector when a block is left out, shape (B, P), by one linear step.

        A weak prior holds a parameter that one block alone determines. A parameter whose `held` is not nan moves by it.
        """
        return self.blocks.without(self.ridge + self.layout.prior(self.chain, self.point), self.pull, held)

    def fitted(self) -> Fitted:
        """Fit with the leave-one-block-out losses, by one linear step."""
        moves = self.left_out_moves()
        losses, jackknife = self.blocks.errors(moves), np.sqrt(np.diag(spread(moves)))
        errors: tuple[dict[str, float], ...] = tuple({} for _ in self.terms)
        for place, (term, parameter) in enumerate(self.layout.searched, start=self.layout.effects):
            errors[term][parameter.name] = float(jackknife[place])
        counted = np.where(self.counting, self.blocks.samples, 0.0)
        samples = np.maximum(self.blocks.samples, 1.0)
        left_out = np.where(self.counting, np.maximum(losses, 1e-12), 1e-12) / samples
        return Fitted(self.terms, self.point, left_out, self.counting * self.blocks.square / samples, counted, errors)


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
