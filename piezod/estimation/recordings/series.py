"""A recording prepared for a fit: equal steps, weights, initial state and blocks."""

import itertools
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array, Mask
from piezod.recording.hold import STRAIGHT, Hold

Role = Literal["identification", "recording"]

BLOCK_S = 2.0
FEWEST_BLOCKS, MOST_BLOCKS = 12, 40  # six blocks could not show significance: 2^-6 is above 0.01


@dataclass(frozen=True)
class Series:
    """A recording on equal steps. A missing reading is 0 and does not count."""

    name: str  # of the file
    role: Role  # "identification": the model was identified on it. "recording": to explain
    time_s: Array  # from 0, shape (N,) [s]
    command_V: Array  # shape (N,) [V]
    reading_N: Array  # shape (N,) [N]
    counts: Mask  # readings that count, shape (N,)
    noise_N: float  # standard deviation of the noise [N]; it weights the recordings against each other
    path_V: tuple[float, ...] = ()  # voltages from the de-energised state to the first sample [V]
    temperature_C: Array | None = None  # shape (N,) [degC]; None: not recorded
    start_s: float = 0.0  # time of the first sample in the file [s]
    hold: Hold = STRAIGHT  # how the command runs between samples
    recorded_hold: Hold | None = None  # hold that the recording states; None: it states none
    lattice_N: float = 0.0  # step of the converter [N]; 0: the readings are not on steps
    rounding_N: Array | None = None  # estimated rounding of the converter, shape (N,) [N]; None: fitted as they are
    trust: Array | None = None  # weight of each reading, shape (N,), 0 to 1; None: all 1
    within_N: Array | None = None  # deviation of the force that a reading does not show, shape (N,) [N]; None: 0
    start_columns: Array = field(default_factory=lambda: np.empty((0, 0)))  # of an unknown past, shape (N, columns) [1]
    past_matters_until: int = 0  # sample from which the start columns are constant
    past_known: NDArray[np.bool_] | None = None  # samples without effect of an unknown past, (N,); None: past is known
    frozen: tuple[tuple[int, int], ...] = ()  # first sample and end of each stretch of frozen readings
    notes: tuple[str, ...] = ()  # remarks of the preparation
    blocks: tuple[slice, ...] = field(init=False)  # stretches that are left out one by one

    def __post_init__(self) -> None:
        size = self.time_s.size
        count = int(np.clip(self.duration_s / BLOCK_S, FEWEST_BLOCKS, MOST_BLOCKS))
        object.__setattr__(self, "blocks", equal_parts(size, min(count, size)))

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


def equal_parts(size: int, count: int) -> tuple[slice, ...]:
    """Contiguous parts of a recording of `size` samples, with nearly equal lengths."""
    edges = np.linspace(0, size, count + 1).astype(int).tolist()
    return tuple(slice(first, end) for first, end in itertools.pairwise(edges))
