"""Cells of an axis with the scores of a residual and of its references."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array, Index, Mask
from piezod.estimation.recordings.series import Series

LEAST_WIDTH = 1e-6  # least distance of two edges, relative to the range; nearer ones differ by rounding
MOST_REFERENCES, MOST_NUMBERS = 20, 4_000_000  # references computed at once, and numbers in them: limits the memory


@dataclass(frozen=True)
class NormalisedResidual:
    """Residual of a recording without its mean [noise rms], 0 where readings do not count (`counts`), shape (N,)."""

    series: Series
    residual: Array
    modelled_N: Array
    counts: Mask

    @classmethod
    def of(cls, series: Series, residual_N: Array, modelled_N: Array) -> "NormalisedResidual":
        """Normalise a residual."""
        counts = series.counts & np.isfinite(residual_N)
        mean = float(residual_N[counts].mean()) if counts.any() else 0.0
        return cls(series, np.where(counts, residual_N - mean, 0.0) / series.noise_N, modelled_N, counts)

    @classmethod
    def diagnosed(
        cls, series: Sequence[Series], residuals: Sequence[Array], modelled: Sequence[Array]
    ) -> list["NormalisedResidual"]:
        """Normalised residuals of the diagnosed recordings with at least one reading that counts."""
        return [
            cls.of(s, residual_N, modelled_N)
            for s, residual_N, modelled_N in zip(series, residuals, modelled, strict=True)
            if s.role == "recording" and s.counts.any()
        ]


@dataclass(frozen=True)
class Cells:
    """Cells of an axis."""

    axis: str  # axis of a `Place`
    low: Array  # low, high: ends of every cell, shape (C,)
    high: Array
    score: Array  # scores of the residual (first row) and of every reference, shape (1 + references, C)
    energy: Array  # energy in every cell beyond the references [noise variance], shape (C,)
    kind: Index  # neighbouring cells of one kind form one place, shape (C,)


def distinct(edges: Array) -> Array:
    """Edges without those that differ by rounding only."""
    least = LEAST_WIDTH * max(float(np.ptp(edges)), 1e-300)
    different = [float(edges[0])]
    for edge in edges[1:]:
        if edge - different[-1] > least:
            different.append(float(edge))
    return np.array(different if len(different) > 1 else [different[0], float(edges[-1])])


def standardised(values: Array) -> Array:
    """Distance from the mean in standard deviations over residual and references, shape (..., 1 + references, C)."""
    centred = values - values.mean(axis=-2, keepdims=True)
    result: Array = np.abs(centred) / np.maximum(centred.std(axis=-2, keepdims=True), 1e-12)
    return result


def excess_energy(energy: Array) -> Array:
    """Energy of the residual (first row) above the mean of the references, at least 0, shape (C,)."""
    result: Array = np.maximum(energy[0] - energy[1:].mean(axis=0), 0.0)
    return result


def references_at_once(size: int) -> int:
    """Number of references of `size` values that are computed at once."""
    return int(np.clip(MOST_NUMBERS // size, 1, MOST_REFERENCES))
