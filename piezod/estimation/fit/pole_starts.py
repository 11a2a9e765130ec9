"""Start of the poles of linear dynamics: equation-error models of several orders at several rates.

Each model is improved by prefilters. K. Steiglitz, L. E. McBride (1965), A technique for the identification of linear
systems, IEEE Transactions on Automatic Control 10(4).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.estimation.fit.blocks import solved

Poles = NDArray[np.complex128]
"""Real poles, and the upper pole of each complex pair, shape (K,) [1/s]."""

BOXES = (1, 4, 16, 64)  # rates of the start, in samples: a model of many samples a period is badly conditioned
LEAST_ROWS = 200  # of an averaged recording
ORDERS = (1, 2, 4, 6, 8, 12, 16)
PREFILTERS = 4  # rounds of Steiglitz and McBride
FASTEST = 0.5  # shortest time constant [samples of the start]; a faster one is a direct gain
LONGEST, LONGEST_RINGING = 0.5, 0.1
"""Longest time constant of a lag, and of a mode, relative to the recording: a mode that rings longer is a tone."""


@dataclass(frozen=True)
class Driven:
    """Command and residual of a recording.

    Parameters
    ----------
    command, residual
        Shape (N,) [input unit], [output unit].
    counts
        Whether a residual counts, shape (N,).
    dt_s
        Sample period [s].
    noise
        Noise of a residual [output unit].
    """

    command: Array
    residual: Array
    counts: NDArray[np.bool_]
    dt_s: float
    noise: float

    def averaged(self, box: int) -> "Driven":
        """Means over boxes of samples; a box with a missing residual does not count."""
        rows = self.command.size // box
        shape = (rows, box)
        command, residual = (
            values[: rows * box].reshape(shape).mean(axis=1)
            for values in (self.command, np.where(self.counts, self.residual, 0.0))
        )
        counts: NDArray[np.bool_] = np.all(self.counts[: rows * box].reshape(shape), axis=1)
        return Driven(command, residual, counts, box * self.dt_s, self.noise / np.sqrt(box))


def starting_poles(recordings: Sequence[Driven]) -> list[Poles]:
    """Poles of equation-error models of each order at each rate, from the longest recording."""
    longest = max(recordings, key=lambda recording: recording.command.size)
    duration_s = longest.command.size * longest.dt_s
    starts = []
    for box in BOXES:
        rows = longest.averaged(box)
        if rows.command.size < LEAST_ROWS:
            break
        command, residual = rows.command - rows.command.mean(), _filled(rows)
        for order in ORDERS:
            if 8 * order > rows.command.size:
                break
            poles = _continuous(_steiglitz_mcbride(command, residual, order), rows.dt_s, duration_s)
            if poles.size:
                starts.append(poles)
    return starts


def _filled(rows: Driven) -> Array:
    """Residual without its mean; missing ones are interpolated."""
    places = np.arange(rows.residual.size)
    filled = np.interp(places, places[rows.counts], rows.residual[rows.counts])
    centred: Array = filled - filled.mean()
    return centred


def _steiglitz_mcbride(command: Array, residual: Array, order: int) -> Array:
    """Denominator of a transfer function of an order, shape (order + 1,)."""
    none: Array = np.eye(1, order + 1)[0]
    denominator = none
    for _ in range(PREFILTERS):
        u, y = _recursive(command, denominator), _recursive(residual, denominator)
        rows = np.array([-_delayed(y, k) for k in range(1, order + 1)] + [_delayed(u, k) for k in range(order + 1)]).T
        denominator = _stable(np.concatenate(([1.0], solved(rows.T @ rows, rows.T @ y)[:order])))
        if not np.isfinite(denominator).all():
            return none
    return denominator


def _stable(denominator: Array) -> Array:
    """Denominator with the roots outside the unit circle mirrored into it."""
    if not np.isfinite(denominator).all():
        return denominator
    roots = np.roots(denominator)
    outside = np.abs(roots) >= 1.0
    roots[outside] = 0.999 / np.conj(roots[outside])
    mirrored: Array = np.real(np.poly(roots))
    return mirrored


def _delayed(values: Array, k: int) -> Array:
    delayed: Array = np.concatenate((np.zeros(k), values[: values.size - k]))
    return delayed


@numba.njit(cache=True)
def _recursive(values: Array, denominator: Array) -> Array:
    """Values behind 1 / denominator, from rest."""
    behind = np.empty(values.size)
    for k in range(values.size):
        value = values[k]
        for j in range(1, min(denominator.size, k + 1)):
            value -= denominator[j] * behind[k - j]
        behind[k] = value
    return behind


def _continuous(denominator: Array, dt_s: float, duration_s: float) -> Poles:
    """Continuous poles of a sampled denominator; only poles that the samples can show."""
    roots = np.roots(denominator)
    roots = roots[(np.abs(roots) > np.exp(-1.0 / FASTEST)) & (np.abs(roots) < 1.0)]
    roots = roots[(roots.imag > 0.0) | ((roots.imag == 0.0) & (roots.real > 0.0))]
    poles: Poles = np.log(roots.astype(complex)) / dt_s
    return poles[fade(poles, duration_s)]


def fade(poles: Poles, duration_s: float) -> NDArray[np.bool_]:
    """Whether each pole fades early enough within a recording to be no tone or drift, shape (K,)."""
    fade: NDArray[np.bool_] = -poles.real * np.where(poles.imag == 0.0, LONGEST, LONGEST_RINGING) * duration_s > 1.0
    return fade
