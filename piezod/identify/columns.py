"""From samples to Gram matrices: the columns of the identification problem, accumulated chunk by chunk.

A recording of any length passes through once; only matrices as large as the number of weights are kept.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.operators.dead_zone import dead_zone_columns
from piezod.operators.play import play_states_run, play_step

Array = NDArray[np.float64]

CHUNK = 16_384  # samples; a chunk's columns stay in the cache of a small machine


@dataclass(frozen=True)
class Structure:
    """Which operators are identified.

    Parameters
    ----------
    play_thresholds
        r_i [V], shape (n + 1,), from 0.
    zone_thresholds
        r'_j [output unit above `origin`], shape (m + 1,) or (2m + 1,), one of them 0.
    origin
        Output where the dead zones start [output unit].
    u_max
        Largest input [V].
    zone_scale
        Input range over output range [V per output unit].
    """

    play_thresholds: Array
    zone_thresholds: Array
    origin: float
    u_max: float
    zone_scale: float

    @property
    def columns(self) -> int:
        """Plays, one constant, dead zones."""
        return int(self.play_thresholds.size + 1 + self.zone_thresholds.size)


class Regressors:
    """Columns [plays, 1, -dead zones] of successive samples of one recording; the play states carry over.

    Parameters
    ----------
    structure
        Which operators.
    first_u
        Input that the plays are brought to first, from the de-energised state (3.2).
    """

    def __init__(self, structure: Structure, first_u: float = 0.0) -> None:
        thresholds = structure.play_thresholds
        self._structure = structure
        self._packed = np.concatenate((thresholds, np.zeros(2 * thresholds.size)))
        play_step(self._packed, 0, thresholds.size, first_u)

    def plays(self, u: Array) -> Array:
        """States of every play over the next samples, shape (N, n + 1)."""
        count = self._structure.play_thresholds.size
        states = np.empty((u.size, count))
        play_states_run(self._packed, 0, count, u, states)
        return states

    def columns(self, u: Array, y: Array) -> Array:
        """All columns over the next samples, shape (N, q)."""
        structure = self._structure
        count = structure.play_thresholds.size
        phi = np.empty((u.size, structure.columns))
        phi[:, :count] = self.plays(u)
        phi[:, count] = 1.0
        zones = np.empty((u.size, structure.zone_thresholds.size))
        dead_zone_columns(structure.zone_thresholds, y - structure.origin, zones)
        phi[:, count + 1 :] = -zones
        return phi


def accumulate_gram(structure: Structure, u: Array, y: Array) -> Array:
    """Sum of phi phi' over one recording, shape (q, q)."""
    regressors = Regressors(structure)
    gram = np.zeros((structure.columns, structure.columns))
    for start in range(0, u.size, CHUNK):
        phi = regressors.columns(u[start : start + CHUNK], y[start : start + CHUNK])
        gram += phi.T @ phi
    return gram
