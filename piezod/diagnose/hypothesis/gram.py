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
from piezod.diagnose.hypothesis.fit import Normal
from piezod.estimation.fit.blocks import Blocks, solved

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
        (sums, pull), count = normal.beside(columns), columns[0].shape[1]
        recordings = [number for number, series in enumerate(normal.chain.series) for _ in series.blocks]
        source = np.concatenate([np.arange(count)] * len(acts) + [[count]]).astype(int)
        factor = np.hstack([np.repeat(acting[recordings][:, None], count, axis=1) for acting in acts])
        factor = np.hstack((factor, np.ones((len(recordings), 1))))
        inner = sums.square[:, source].take(source, axis=2) * factor[:, :, None] * factor[:, None, :]
        sums = Blocks(sums.gram, sums.side.take(source, axis=2) * factor[:, None, :], inner, sums.samples)
        pull = pull[:, source]
        moves = sums.solve(penalty=normal.ridge, pull=pull)
        followed = sums.without(normal.ridge + normal.layout.prior(normal.chain, normal.point), pull)
        left_out = sums.errors(followed) * normal.counting[:, None, None]
        counted = float(sums.samples[normal.counting].sum())
        squares = np.diag(sums.square.sum(axis=0))
        return cls(sums.left(moves, pull), sums.left(followed, pull), left_out, squares, moves, counted)

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
        fitted = solved(own, sides)  # zeros where the columns differ by rounding only
        return self._loss(chosen, fitted)

    def _loss(self, chosen: NDArray[np.int64], fitted: Array) -> float:
        """Loss with multiples of columns in each block, shape (B, columns)."""
        across, inner = self.left_out[:, chosen, -1], self.left_out[:, chosen[:, None], chosen]
        squares = Blocks(inner, across, self.left_out[:, -1, -1], np.empty(0)).errors(fitted)
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
