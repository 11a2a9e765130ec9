"""Ridge regression from Gram matrices: every block is predicted from the others, which also choose the penalty."""

from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array, Mask
from piezod.diagnose.hypothesis.left_out import sign_test_p
from piezod.estimation.fit.blocks import Blocks

STRENGTHS = (1e-8, 1e-6, 1e-4, 1e-2, 1.0)  # penalties, relative to the variance of a column
FOLDS = 8
FAILED = 2.0  # ratio of a block's losses above which its prediction has failed and the levels alone are used


@dataclass(frozen=True)
class BlockPrediction:
    """Prediction of every block from the others.

    Parameters
    ----------
    before, after
        Squared residual of every block with the levels alone and with all columns, shape (B,).
    weights
        Weights of the columns for every block, shape (B, P); the levels alone where the prediction failed.
    """

    before: Array
    after: Array
    weights: Array

    @property
    def p(self) -> float:
        """Probability of this fall of the logarithmic loss if its sign in every block is random."""
        return sign_test_p(np.log(np.maximum(self.before, 1e-300) / np.maximum(self.after, 1e-300)))


def predicted_blocks(blocks: Blocks, levels: Mask) -> BlockPrediction:
    """Predict every block from the others.

    `levels`: mask of the columns without penalty, shape (P,).
    """
    folds = np.arange(blocks.square.size) % min(FOLDS, blocks.square.size)
    problem = _Problem(blocks.folded(folds), levels)
    weights = np.stack([problem.solved([k], strength) for k, strength in enumerate(problem.strengths())])
    level = np.stack([problem.solved([k], np.inf) for k in range(weights.shape[0])])
    before, after = (np.maximum(blocks.errors(fitted[folds]), 1e-9 * blocks.square) for fitted in (level, weights))
    failed = after > FAILED * before
    chosen = np.where(failed[:, None], level[folds], weights[folds])
    return BlockPrediction(before, np.minimum(after, FAILED * before), chosen)


class _Problem:
    """Normal equations of all folds, with columns of equal norm."""

    def __init__(self, folds: Blocks, levels: Mask) -> None:
        squares = np.diag(folds.total[0])
        self.scale, self.levels = 1.0 / np.sqrt(np.maximum(squares, 1e-12 * squares.max())), levels
        self.folds = folds.along(np.diag(self.scale))
        self.penalty = np.where(levels, 1e-9, self._variance() + 1e-9)

    def _variance(self) -> Array:
        """Squared norm of every column about its mean in each recording."""
        total = self.folds.total[0]
        at = np.flatnonzero(self.levels)
        means = total[at] ** 2 / np.maximum(np.diag(total)[at], 1e-12)[:, None]
        variance: Array = np.maximum(np.diag(total) - means.sum(axis=0), 0.0)
        return variance

    def solved(self, omitted: list[int], strength: float) -> Array:
        """Weights of the unscaled columns from all other folds."""
        weights: Array = self.scale * self._scaled(omitted, strength)
        return weights

    def _scaled(self, omitted: list[int], strength: float) -> Array:
        if np.isinf(strength):
            gram, side = self.folds.rest(omitted)
            weights: Array = np.where(self.levels, side / np.maximum(np.diag(gram), 1e-12), 0.0)
            return weights
        return self.folds.solve(omitted, np.diag(strength * self.penalty + 1e-11))

    def strengths(self) -> list[float]:
        """Penalty for each fold, chosen by cross-validation on the other folds."""
        count, tried = self.folds.square.size, (*STRENGTHS, np.inf)
        losses = np.zeros((count, len(tried)))
        for i in range(count):
            for j in range(i + 1, count):
                for s, strength in enumerate(tried):
                    weights = self._scaled([i, j], strength)
                    losses[[j, i], s] += self.folds.part([i, j]).errors(weights)
        return [float(tried[int(np.argmin(row))]) for row in losses]
