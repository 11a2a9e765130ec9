"""The cells that an axis is cut into, and how a residual's score in each compares with its references."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series

Array = NDArray[np.float64]
Index = NDArray[np.int64]

DECIMALS = 1e-6  # of a range, by which edges differ at least
TOGETHER, MOST_NUMBERS = 20, 4_000_000  # references, and all their values, that are worked on at once


@dataclass(frozen=True)
class Told:
    """A recording's residual in units of its noise, about 0, and 0 where it does not count."""

    series: Series
    residual: Array
    modelled_N: Array

    @classmethod
    def of(cls, series: Series, residual_N: Array, modelled_N: Array) -> "Told":
        """From a residual in newtons."""
        known = series.counts & np.isfinite(residual_N)
        mean = residual_N[known].mean() if known.any() else 0.0
        return cls(series, np.where(known, residual_N - mean, 0.0) / series.noise_N, modelled_N)


@dataclass(frozen=True)
class Cells:
    """Cells of an axis.

    Parameters
    ----------
    axis
        Of a place.
    low, high
        Range of every cell, shape (C,).
    score
        Of the residual and of every reference, shape (1 + shifts, C).
    energy
        Of every cell beyond the reference, in units of the noise, shape (C,).
    kin
        Neighbours of the same kin are one place, shape (C,).
    """

    axis: str
    low: Array
    high: Array
    score: Array
    energy: Array
    kin: Index


def distinct(edges: Array) -> Array:
    """Edges without those that differ by rounding only."""
    least = DECIMALS * max(float(np.ptp(edges)), 1e-300)
    kept = [float(edges[0])]
    for edge in edges[1:]:
        if edge - kept[-1] > least:
            kept.append(float(edge))
    return np.array(kept if len(kept) > 1 else [kept[0], float(edges[-1])])


def standard(values: Array) -> Array:
    """How far from 0 in standard deviations over the references and the residual, shape (..., 1 + shifts, C)."""
    centred = values - values.mean(axis=-2, keepdims=True)
    result: Array = np.abs(centred) / np.maximum(centred.std(axis=-2, keepdims=True), 1e-12)
    return result


def beyond(energy: Array) -> Array:
    """Energy of the residual less the references' mean, not below 0, shape (C,)."""
    result: Array = np.maximum(energy[0] - energy[1:].mean(axis=0), 0.0)
    return result


def together(size: int) -> int:
    """How many references of so many values are worked on at once: those of a long recording are few."""
    return int(np.clip(MOST_NUMBERS // size, 1, TOGETHER))
