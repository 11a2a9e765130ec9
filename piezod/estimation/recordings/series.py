"""A recording prepared for a fit: equal steps, weights, initial state and blocks."""

import itertools
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.recording.hold import STRAIGHT, Hold

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Role = Literal["identification", "recording"]

BLOCK_S = 2.0
FEWEST_BLOCKS, MOST_BLOCKS = 12, 40  # six blocks could not show significance: 2^-6 is above 0.01


@dataclass(frozen=True)
class Series:
    """A recording on equal steps.

    Parameters
    ----------
    name
        Name of the file.
    role
        "identification": the model was identified on it. "recording": to explain.
    time_s, command_V, reading_N
        Times from 0 [s], commands [V] and readings [N], shape (N,). A missing reading is 0 and does not count.
    counts
        Readings that count, shape (N,).
    noise_N
        Standard deviation of the noise [N]; it weights the recordings against each other.
    path_V
        Voltages from the de-energised state to the first sample [V].
    temperature_C
        Temperatures, shape (N,) [degC]; None: not recorded.
    start_s
        Time of the first sample in the file [s].
    start_columns
        Columns of an unknown past in the stroke, shape (N, columns) [1]; no columns where the past is known.
    past_matters_until
        Sample from which the start columns are constant.
    past_known
        Samples at which the unknown past no longer matters, shape (N,). None: the past is known.
    hold
        How the command runs between samples.
    recorded_hold
        Hold that the recording states; None: it states none.
    lattice_N
        Step of the converter [N]; 0: the readings are not on steps.
    rounding_N
        Estimated rounding of the converter, shape (N,) [N]; None: the readings are fitted as they are.
    trust
        Weight of each reading, shape (N,), 0 to 1; None: all 1.
    within_N
        Deviation of the force that a reading does not show, shape (N,) [N]; None: 0.
    frozen
        First sample and end of each stretch of frozen readings, which do not count.
    notes
        Remarks of the preparation.
    blocks
        Stretches that are left out one by one.
    """

    name: str
    role: Role
    time_s: Array
    command_V: Array
    reading_N: Array
    counts: Mask
    noise_N: float
    path_V: tuple[float, ...] = ()
    temperature_C: Array | None = None
    start_s: float = 0.0
    hold: Hold = STRAIGHT
    recorded_hold: Hold | None = None
    lattice_N: float = 0.0
    rounding_N: Array | None = None
    trust: Array | None = None
    within_N: Array | None = None
    start_columns: Array = field(default_factory=lambda: np.empty((0, 0)))
    past_matters_until: int = 0
    past_known: NDArray[np.bool_] | None = None
    frozen: tuple[tuple[int, int], ...] = ()
    notes: tuple[str, ...] = ()
    blocks: tuple[slice, ...] = field(init=False)

    def __post_init__(self) -> None:
        size = self.time_s.size
        count = int(np.clip(self.duration_s / BLOCK_S, FEWEST_BLOCKS, MOST_BLOCKS))
        edges = np.linspace(0, size, min(count, size) + 1).astype(int)
        blocks = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))
        object.__setattr__(self, "blocks", blocks)

    def fitted_N(self, rows: slice) -> Array:
        """Readings to fit, shape (rows,) [N]: less the rounding of a coarse converter."""
        readings = self.reading_N[rows]
        return readings if self.rounding_N is None else readings - self.rounding_N[rows]

    def weights(self, rows: slice) -> Array:
        """Weights of the residuals, shape (rows,); 0 where a reading does not count."""
        counts = self.counts[rows].astype(np.float64)
        return counts if self.trust is None else self.trust[rows] * counts

    def residual(self, rows: slice, reading_N: Array) -> tuple[Array, Array]:
        """Residuals of simulated readings, shape (rows,) [noise], and their weights, shape (rows,).

        Parameters
        ----------
        reading_N
            Simulated readings, shape (rows,) [N].
        """
        error_N, weights = self.fitted_N(rows) - reading_N, self.weights(rows)
        if self.within_N is not None:
            beyond_N = error_N - np.clip(error_N, -self.within_N[rows], self.within_N[rows])
            error_N, weights = beyond_N, weights * (beyond_N != 0.0)
        return np.where(weights > 0.0, weights * error_N, 0.0) / self.noise_N, weights

    def as_judged(self) -> "Series":
        """Series in which only readings count that no longer depend on an unknown past."""
        if self.past_known is None:
            return self
        return replace(self, counts=self.counts & self.past_known)

    def block_counts(self, block: slice) -> bool:
        """Whether a block counts: with an unknown past, any hypothesis fits the first ones."""
        return self.past_known is None or bool(self.past_known[block].all())

    @property
    def dt_s(self) -> float:
        """Spacing of the samples [s]."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time_s[-1])
