"""Ridge regression from Gram matrices: every block is predicted from the others, which also choose the penalty."""

from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array, Index, Mask

STRENGTHS = (1e-8, 1e-6, 1e-4, 1e-2, 1.0)  # penalties, relative to the variance of a column
FOLDS = 8
FLIPS = 999
FAILED = 2.0  # ratio of a block's losses above which its prediction has failed and the levels alone are used


@dataclass(frozen=True)
class Blocks:
    """Sums over every block.

    Parameters
    ----------
    gram, product
        Products of the columns with each other, shape (B, P, P), and with the residual, shape (B, P).
    square, samples
        Squared residual and number of samples, shape (B,).
    """

    gram: Array
    product: Array
    square: Array
    samples: Array

    @property
    def folds(self) -> Index:
        """Number of the fold of every block, shape (B,)."""
        return np.arange(self.square.size) % min(FOLDS, self.square.size)


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

    def p(self, rng: np.random.Generator) -> float:
        """Probability of this fall of the logarithmic loss if its sign in every block is random."""
        gains = np.log(np.maximum(self.before, 1e-300) / np.maximum(self.after, 1e-300))
        if not np.any(gains):
            return 1.0
        signs = rng.choice((-1.0, 1.0), (FLIPS, gains.size))
        return float((1 + np.count_nonzero(signs @ gains >= gains.sum())) / (1 + FLIPS))


def predicted_blocks(blocks: Blocks, levels: Mask) -> BlockPrediction:
    """Predict every block from the others.

    `levels`: mask of the columns without penalty, shape (P,).
    """
    folds = blocks.folds
    count = int(folds.max()) + 1
    gram = np.stack([blocks.gram[folds == k].sum(axis=0) for k in range(count)])
    product = np.stack([blocks.product[folds == k].sum(axis=0) for k in range(count)])
    problem = _Problem(gram, product, levels)
    strengths = problem.strengths()
    weights = np.stack([problem.solved([k], strengths[k]) for k in range(count)])
    level = np.stack([problem.solved([k], np.inf) for k in range(count)])
    before, after = _losses(blocks, level[folds]), _losses(blocks, weights[folds])
    failed = after > FAILED * before
    chosen = np.where(failed[:, None], level[folds], weights[folds])
    return BlockPrediction(before, np.minimum(after, FAILED * before), chosen)


def _losses(blocks: Blocks, weights: Array) -> Array:
    curved = np.einsum("bi,bij,bj->b", weights, blocks.gram, weights, optimize=True)
    result: Array = blocks.square - 2.0 * np.einsum("bi,bi->b", weights, blocks.product) + curved
    return np.maximum(result, 1e-9 * blocks.square)


class _Problem:
    """Normal equations of all folds, with columns of equal norm."""

    def __init__(self, gram: Array, product: Array, levels: Mask) -> None:
        total = gram.sum(axis=0)
        self.scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-12 * np.diag(total).max()))
        self.gram = gram * np.outer(self.scale, self.scale)
        self.product = product * self.scale
        self.levels = levels
        self.total, self.total_product = self.gram.sum(axis=0), self.product.sum(axis=0)
        self.penalty = np.where(levels, 1e-9, self._variance() + 1e-9)

    def _variance(self) -> Array:
        """Squared norm of every column about its mean in each recording."""
        at = np.flatnonzero(self.levels)
        means = self.total[at] ** 2 / np.maximum(np.diag(self.total)[at], 1e-12)[:, None]
        variance: Array = np.maximum(np.diag(self.total) - means.sum(axis=0), 0.0)
        return variance

    def solved(self, without: list[int], strength: float) -> Array:
        """Weights of the unscaled columns from all other folds."""
        weights: Array = self.scale * self._scaled(without, strength)
        return weights

    def _scaled(self, without: list[int], strength: float) -> Array:
        gram = self.total - self.gram[without].sum(axis=0)
        product = self.total_product - self.product[without].sum(axis=0)
        if np.isinf(strength):
            weights = np.zeros(product.size)
            at = self.levels
            weights[at] = product[at] / np.maximum(np.diag(gram)[at], 1e-12)
            return weights
        gram[np.diag_indices_from(gram)] += strength * self.penalty + 1e-11
        result: Array = np.linalg.solve(gram, product)
        return result

    def strengths(self) -> list[float]:
        """Penalty for each fold, chosen by cross-validation on the other folds."""
        count, tried = self.gram.shape[0], (*STRENGTHS, np.inf)
        losses = np.zeros((count, len(tried)))
        for i in range(count):
            for j in range(i + 1, count):
                for s, strength in enumerate(tried):
                    weights = self._scaled([i, j], strength)
                    losses[i, s] += self._loss(j, weights)
                    losses[j, s] += self._loss(i, weights)
        return [float(tried[int(np.argmin(row))]) for row in losses]

    def _loss(self, fold: int, weights: Array) -> float:
        return float(weights @ self.gram[fold] @ weights - 2.0 * weights @ self.product[fold])
