"""Left-out losses of many hypotheses at once, from products of their columns in every block.

A further effect is a finite change of the readings: one more column next to the tangents of the fitted hypothesis. The
products of all columns are added up block by block, once. The tangents of the fitted parameters are eliminated, for
all data and for the data without each block. The remaining products give the loss of every hypothesis in each block
that had no part in its fit, by algebra on a few numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.hypothesis.fit import Normal, thinned
from piezod.estimation.fit.blocks import solved

INDEPENDENT = 1e-6  # least share of a column's square that the fitted parameters do not follow
INDEPENDENT_PAIR = 1e-4  # least share of a column's square that another column does not follow either
WITHIN = 1.0  # prior width of a column's multiple, relative to the multiple in all data; one block may determine it


@dataclass(frozen=True)
class Eliminated:
    """Products of further columns and of the residual, with the fitted parameters eliminated.

    The residual is the last of the K + 1 columns.

    Parameters
    ----------
    whole
        Products over all data, shape (K + 1, K + 1).
    training
        Products over the data without each block, shape (B, K + 1, K + 1).
    left_out
        Products in the block, with the parameters fitted without it, shape (B, K + 1, K + 1).
    squares
        Squares of the columns before the elimination, shape (K + 1,).
    moves
        Parameters per unit of each column, shape (P, K + 1).
    counted
        Number of samples in the blocks that count; other blocks are 0 in `left_out`.
    """

    whole: Array
    training: Array
    left_out: Array
    squares: Array
    moves: Array
    counted: float

    @classmethod
    def at(cls, normal: Normal, columns: Sequence[Array], acts: Sequence[Array]) -> "Eliminated":
        """Products at a fitted hypothesis.

        Parameters
        ----------
        normal
            Normal equations of the hypothesis, not robust.
        columns
            Changes of the compared readings, an array of shape (rows, C) per recording [N].
        acts
            Recordings in which the columns act, each of shape (R,): the C columns are used once with each entry.
        """
        parameters, blocks, recordings = normal.ridge.shape[0], [], []
        for number, series in enumerate(normal.chain.series):
            scale = (normal.trust[number] / series.noise_N)[:, None]
            parts = normal.jacobians[number], columns[number] * scale, normal.weighted[number][:, None]
            rows = np.hstack(parts)
            for block in thinned(series.blocks, normal.chain.rows[number].step):
                blocks.append(rows[block].T @ rows[block])
                recordings.append(number)
        count = columns[0].shape[1]
        source = np.concatenate([parameters + np.arange(count)] * len(acts) + [[parameters + count]]).astype(int)
        factor = np.hstack([np.repeat(acting[recordings][:, None], count, axis=1) for acting in acts])
        factor = np.hstack((factor, np.ones((len(blocks), 1))))
        return cls._of(normal, np.array(blocks), source, factor)

    @classmethod
    def _of(cls, normal: Normal, blocks: Array, source: NDArray[np.int64], factor: Array) -> "Eliminated":
        """Products of the columns `source`, times a factor in each block, shape (B, K + 1)."""
        fitted = slice(0, normal.ridge.shape[0])
        hessian, across = blocks[:, fitted, fitted], blocks[:, fitted][:, :, source] * factor[:, None, :]
        inner = blocks[:, source][:, :, source] * factor[:, :, None] * factor[:, None, :]
        curvature = hessian.sum(axis=0) + normal.ridge
        all_across, all_inner = across.sum(axis=0), inner.sum(axis=0)
        all_across[:, -1] += normal.pull
        scale = 1.0 / np.sqrt(np.maximum(np.diag(curvature), 1e-300))
        moves = _solved(curvature, all_across, scale)
        held = curvature + normal.layout.prior(normal.chain, normal.point)
        training, left_out = np.empty_like(inner), np.zeros_like(inner)
        for b in range(len(blocks)):
            sides = all_across - across[b]
            followed = _solved(held - hessian[b], sides, scale)
            training[b] = all_inner - inner[b] - sides.T @ followed
            if normal.counting[b]:
                once = across[b].T @ followed
                left_out[b] = inner[b] - once - once.T + followed.T @ (hessian[b] @ followed)
        counted = float(normal.samples[normal.counting].sum())
        whole = all_inner - all_across.T @ moves
        return cls(whole, training, left_out, np.diag(all_inner), moves, counted)

    @property
    def loss(self) -> float:
        """Loss without any further column, mean square per sample in the blocks left out [noise variance]."""
        return float(self.left_out[:, -1, -1].sum()) / self.counted

    def multiples(self, group: Sequence[int]) -> Array:
        """Multiples with which columns join the fit together, shape (group,); 0 where nothing of a column is left."""
        chosen = np.asarray(group)
        result = np.zeros(chosen.size)
        own = np.diag(self.whole)[chosen] > INDEPENDENT * self.squares[chosen]
        if own.any():
            used = chosen[own]
            result[own] = solved(self.whole[np.ix_(used, used)], self.whole[used, -1])
        return result

    def loss_with(self, group: Sequence[int], multiples: Array) -> float:
        """Loss with columns that have about these multiples, fitted without each block; see `loss`."""
        used = np.flatnonzero(multiples)
        if not used.size:
            return self.loss
        chosen, about = np.asarray(group)[used], multiples[used]
        prior = np.diag((WITHIN * about) ** -2.0)
        own = self.training[:, chosen[:, None], chosen] + prior
        sides = self.training[:, chosen, -1] + prior @ about
        try:
            fitted = np.asarray(np.linalg.solve(own, sides[:, :, None])[:, :, 0], dtype=np.float64)
        except np.linalg.LinAlgError:
            return self.loss  # the columns differ by rounding only
        return self._loss(chosen, fitted)

    def _loss(self, chosen: NDArray[np.int64], fitted: Array) -> float:
        """Loss with multiples of columns in each block, shape (B, columns)."""
        across = self.left_out[:, chosen, -1]
        inner = self.left_out[:, chosen[:, None], chosen]
        squares = self.left_out[:, -1, -1] - 2.0 * np.sum(fitted * across, axis=1)
        squares += np.einsum("bi,bij,bj->b", fitted, inner, fitted)
        return float(np.maximum(squares, 0.0).sum()) / self.counted

    def pair_gains(self, groups: Sequence[Sequence[int]]) -> Array:
        """Fall of the squared residual by every two groups of columns, shape (groups, groups); alone on the diagonal.

        A group of several columns has the multiples that it would have alone. The gain is 0 where two are too alike.
        """
        merged = np.zeros((self.squares.size, len(groups)))
        for place, group in enumerate(groups):
            merged[list(group), place] = self.multiples(group) if len(group) > 1 else 1.0
        inner, along = merged.T @ self.whole @ merged, merged.T @ self.whole[:, -1]
        own = np.diag(inner)
        independent = own > INDEPENDENT * np.square(merged.T) @ self.squares
        determinants = np.outer(own, own) - inner**2
        pairs = independent[:, None] & independent & (determinants > INDEPENDENT_PAIR * np.outer(own, own))
        with np.errstate(divide="ignore", invalid="ignore"):
            multiples = (along[:, None] * own - along * inner) / determinants
            gains = multiples * along[:, None] + multiples.T * along
            alone = along**2 / own
        gains = np.where(pairs, gains, 0.0)
        np.fill_diagonal(gains, np.where(independent, alone, 0.0))
        return gains


def _solved(matrix: Array, sides: Array, scale: Array) -> Array:
    """Solutions of normal equations for several sides, shape (P, K); zeros where there is none."""
    scaled = matrix * np.outer(scale, scale) + 1e-13 * np.eye(scale.size)
    try:
        result: Array = scale[:, None] * np.linalg.solve(scaled, scale[:, None] * sides)
    except np.linalg.LinAlgError:
        result = np.zeros_like(sides)
    return result
