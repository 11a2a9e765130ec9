"""Section `information` of a model file: how well the recordings determine the parameters, in place of their samples.

With R the upper triangular matrix of `root`, R^T R is the information matrix of the parameters: the inverse of their
covariance. Coloured noise is considered in it. Parameters that belong to one recording, such as offsets, are
marginalised. The information of other recordings adds to R^T R.
"""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from piezod.arrays import Array
from piezod.config.checked import Section

Finite = Annotated[tuple[float, ...], Field(strict=False)]
Interval = Annotated[tuple[float, float], Field(strict=False)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]

DENSITY, LAW = "density", "law"  # first part of the names of the base's parameters, before a dot and a number
DIGITS = 8  # of a number in the file
RIDGES = (0.0, 1e-14, 1e-12, 1e-10, 1e-8)  # relative to the diagonal; the smallest that makes the matrix definite


class Information(Section):
    """Information on the parameters of a model.

    `names` are the rows of `root`: `density.K` and `law.K` of the base, and `EFFECT.PARAMETER`. `estimate` are their
    values. Row k of `root` begins at the diagonal. `reach` is the widest play of the density, and `law_range` are the
    ends of the force law [input unit]. `noise` is the rms noise [output unit]. `colour` are the coefficients a of its
    autoregression e_k = sum_j a_j e_(k-j) + white noise. `driven` is the range of the input [input unit]. `gain` and
    `loop_width_percent` are 95 % intervals of the figures of the base.
    """

    recordings: Annotated[tuple[Sha256, ...], Field(strict=False)]
    driven: Interval
    noise: Annotated[float, Field(gt=0)]
    colour: Finite = ()
    gain: Interval
    loop_width_percent: Interval
    reach: Annotated[float, Field(gt=0)]
    law_range: Interval
    names: Annotated[tuple[str, ...], Field(strict=False)] = ()
    estimate: Finite = ()
    root: Annotated[tuple[Finite, ...], Field(strict=False)] = ()

    @model_validator(mode="after")
    def _sizes_agree(self) -> Self:
        count = len(self.names)
        if len(self.estimate) != count or [len(row) for row in self.root] != list(range(count, 0, -1)):
            raise ValueError(f"estimate and root must have {count} rows, one for each name, each from the diagonal on")
        if len(set(self.names)) != count:
            raise ValueError("names must differ")
        return self

    @property
    def matrix(self) -> Array:
        """Information matrix R^T R, shape (P, P) [1 / (unit of row * unit of column)]."""
        triangle = np.zeros((len(self.names), len(self.names)))
        for k, row in enumerate(self.root):
            triangle[k, k:] = row
        return triangle.T @ triangle


def packed(matrix: Array) -> tuple[tuple[float, ...], ...]:
    """Rows of the upper triangular root of an information matrix, each from its diagonal on.

    Parameters
    ----------
    matrix
        Symmetric, shape (P, P). A direction without information gets a small one.
    """
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix / np.outer(scale, scale)
    root = np.eye(scale.size)
    for ridge in RIDGES:
        try:
            root = np.linalg.cholesky(scaled + ridge * np.eye(scale.size)).T
            break
        except np.linalg.LinAlgError:
            continue
    return tuple(tuple(rounded(value) for value in row[k:]) for k, row in enumerate(root * scale))


def marginal(matrix: Array, places: NDArray[np.int64]) -> Array:
    """Information on the parameters at these places if the others are unknown, shape (len(places), len(places)).

    It is the Schur complement of the others' block.
    """
    others = np.setdiff1d(np.arange(matrix.shape[0]), places)
    inside = matrix[np.ix_(places, places)]
    if not others.size:
        return inside
    scale = np.sqrt(np.maximum(np.diag(matrix)[others], 1e-300))
    across = matrix[np.ix_(others, places)] / scale[:, None]
    block = matrix[np.ix_(others, others)] / np.outer(scale, scale)
    shared = across.T @ np.linalg.pinv(block, rcond=1e-13, hermitian=True) @ across
    return inside - 0.5 * (shared + shared.T)


def rounded(value: float) -> float:
    """Value with the digits of the file."""
    return float(f"{value:.{DIGITS}g}")
