"""Sums of a least-squares fit by block: every block is predicted by a fit of the others, without its samples.

The squared error of a block at the parameters x is square - 2 x' side + x' gram x. The sums of the other blocks are the
total without its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezod.arrays import Array, Index, Mask

FOLDS = 4  # contiguous folds of a recording
DEPENDENT = 1e-13  # penalty of a column scaled to unit curvature, so that dependent columns share their size


@dataclass(frozen=True)
class Blocks:
    """Sums by block.

    Parameters
    ----------
    gram
        Products of the columns with each other, shape (B, P, P).
    side
        Products of the columns with the target, shape (B, P), or with K targets, shape (B, P, K).
    square
        Square of the target, shape (B,), or products of the targets with each other, shape (B, K, K).
    samples
        Number of samples, shape (B,).
    """

    gram: Array
    side: Array
    square: Array
    samples: Array

    @classmethod
    def of(cls, columns: Array, target: Array, parts: Sequence[slice | Index | Mask]) -> "Blocks":
        """Sums over parts of weighted columns, shape (N, P), and of a weighted target, shape (N,)."""
        rows = [(columns[part], target[part]) for part in parts]
        return cls(
            np.array([own.T @ own for own, _ in rows]),
            np.array([own.T @ value for own, value in rows]),
            np.array([value.T @ value for _, value in rows]),
            np.array([float(value.shape[0]) for _, value in rows]),
        )

    @classmethod
    def all_of(cls, parts: "Sequence[Blocks]") -> "Blocks":
        """Blocks of several recordings, one after the other."""
        sums = [(one.gram, one.side, one.square, one.samples) for one in parts]
        return cls(*(np.concatenate(arrays) for arrays in zip(*sums, strict=True)))

    def folded(self, folds: Index) -> "Blocks":
        """Sums of the blocks of each fold; `folds` are their numbers from 0, shape (B,)."""
        members = [folds == k for k in range(int(folds.max()) + 1)]
        arrays = self.gram, self.side, self.square, self.samples
        return Blocks(*(np.array([sums[chosen].sum(axis=0) for chosen in members]) for sums in arrays))

    def part(self, chosen: Sequence[int] | Index | slice) -> "Blocks":
        """Some of the blocks."""
        return Blocks(self.gram[chosen], self.side[chosen], self.square[chosen], self.samples[chosen])

    def along(self, directions: Array) -> "Blocks":
        """Sums of combinations of the columns, the columns of `directions`, shape (P, Q); of one target."""
        return Blocks(directions.T @ self.gram @ directions, self.side @ directions, self.square, self.samples)

    @property
    def rms(self) -> float:
        """Root mean square of one target."""
        return float(np.sqrt(self.square.sum() / self.samples.sum()))

    @cached_property
    def total(self) -> tuple[Array, Array]:
        """Gram and side over all blocks."""
        return self.gram.sum(axis=0), self.side.sum(axis=0)

    def rest(self, omitted: Sequence[int]) -> tuple[Array, Array]:
        """Gram and side over all blocks but the omitted ones."""
        gram, side = self.total
        chosen = list(omitted)
        return gram - self.gram[chosen].sum(axis=0), side - self.side[chosen].sum(axis=0)

    def solve(self, omitted: Sequence[int] = (), penalty: Array | float = 0.0, pull: Array | float = 0.0) -> Array:
        """Parameters fitted to all blocks but the omitted ones, shape of a side.

        `penalty` is added to the gram, shape (P, P), and `pull` to the side.
        """
        gram, side = self.rest(omitted) if len(omitted) else self.total
        return solved(gram + penalty, side + pull)

    def without(self, penalty: Array | float = 0.0, pull: Array | float = 0.0, held: Array | None = None) -> Array:
        """Parameters fitted without each block, shape of `side`; see `solve` and `solved`."""
        gram, side = self.total
        pairs = zip(self.gram, self.side, strict=True)
        return np.array([solved(gram - own + penalty, side - along + pull, held) for own, along in pairs])

    def left(self, parameters: Array, pull: Array | float = 0.0) -> Array:
        """Products of K targets less their parts that fitted parameters follow, shape (K, K), over all blocks.

        Parameters without each block, as `without` returns them, give the products over the others, shape (B, K, K).
        """
        side, square = self.total[1], self.square.sum(axis=0)
        if parameters.ndim == self.side.ndim:
            side, square = side - self.side, square - self.square
        result: Array = square - np.swapaxes(side + pull, -1, -2) @ parameters
        return result

    def errors(self, parameters: Array) -> Array:
        """Squared error of every block, shape of `square`, at parameters of its own or of all, shape of a side."""
        if self.square.ndim == 1:
            targets = Blocks(self.gram, self.side[..., None], self.square[:, None, None], self.samples)
            result: Array = targets.errors(parameters[..., None])[:, 0, 0]
            return result
        turned = np.swapaxes(parameters, -1, -2)
        once = turned @ self.side
        products: Array = self.square - once - np.swapaxes(once, -1, -2) + turned @ (self.gram @ parameters)
        return products


def solved(matrix: Array, side: Array, held: Array | None = None) -> Array:
    """Solutions of one or many normal equations on scaled columns; zeros where there is none.

    Parameters
    ----------
    matrix, side
        Shape (..., P, P), and (..., P) or (..., P, K); the solution has the shape of the side.
    held
        Values that parameters keep, shape (P,); nan: fitted. The matrix is then a single one and the side a vector.
    """
    if held is not None:
        free, result = np.isnan(held), np.nan_to_num(held)
        result[free] = solved(matrix[np.ix_(free, free)], (side - matrix @ result)[free])
        return result
    scale, scaled = _scaled(matrix)
    columns = side if side.ndim == matrix.ndim else side[..., None]
    try:
        solution = np.linalg.solve(scaled + DEPENDENT * np.eye(scale.shape[-1]), columns * scale[..., None])
    except np.linalg.LinAlgError:
        return np.zeros_like(side)
    sizes: Array = (solution * scale[..., None]).reshape(side.shape)
    return sizes


def whitening(matrix: Array) -> Array:
    """Matrix W with W W' = inverse of `matrix` on scaled columns, shape (P, P)."""
    scale, scaled = _scaled(matrix)
    values, vectors = np.linalg.eigh(scaled)
    result: Array = scale[:, None] * vectors / np.sqrt(np.maximum(values, DEPENDENT))
    return result


def _scaled(matrix: Array) -> tuple[Array, Array]:
    """Scale of each column, and the matrix on columns of unit curvature."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), 1e-300))
    return scale, matrix * scale[..., :, None] * scale[..., None, :]


def contiguous_folds(blocks: Sequence[int]) -> Index:
    """Number of the fold of every block of recordings with so many blocks each.

    Folds are contiguous: a slow residual in a block between two near blocks would be interpolated.
    """
    return np.concatenate([np.arange(count) * FOLDS // count for count in blocks])


def spread(moves: Array) -> Array:
    """Jackknife covariance of parameters, shape (P, P), from their values without each block, shape (B, P)."""
    away = moves - moves.mean(axis=0)
    result: Array = (moves.shape[0] - 1) / moves.shape[0] * away.T @ away
    return result
