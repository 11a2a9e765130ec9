"""A recording made ready to be fitted: equal steps, what is believed, how it starts, and its blocks."""

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
FEWEST_BLOCKS, MOST_BLOCKS = 12, 40  # with six, no chance of a sign in each of them would fall below 0.01


@dataclass(frozen=True)
class Series:
    """One recording on equal steps.

    Parameters
    ----------
    name
        Where it came from.
    role
        Whether the model was identified on it, or it is asked about.
    time_s, command_V, reading_N
        Shape (N,); time from 0, readings that are missing are 0 and do not count.
    counts
        Which readings are believed, shape (N,).
    noise_N
        Standard deviation of its noise, for the weights between recordings [N].
    path_V
        Voltages since the de-energised state before the first sample.
    temperature_C
        Shape (N,), or None.
    start_s
        Time of the first sample in the recording's own time [s].
    start_columns
        What an unknown past can have added to the stroke, shape (N, columns) [1]; no columns where it is known.
    past_matters_until
        Sample from which the start columns stay as they are.
    past_known
        Where what is fitted for an unknown past can be judged by, shape (N,). None: the past is known.
    hold
        How the command runs between samples.
    recorded_hold
        The same as the recording states it; None: it does not state it.
    lattice_N
        Step of a converter's lattice on which all readings stand; 0 where there is none [N].
    rounding_N
        What the converter seems to have added to the readings, shape (N,); None where they are taken as they are [N].
    trust
        How much less than `noise_N` each reading is off, as a factor, shape (N,), 0 where it tells nothing; None where
        all are alike.
    within_N
        How far from it the force may be without a reading telling, shape (N,); None: not at all [N].
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
    blocks: tuple[slice, ...] = field(init=False)

    def __post_init__(self) -> None:
        size = self.time_s.size
        count = int(np.clip(self.duration_s / BLOCK_S, FEWEST_BLOCKS, MOST_BLOCKS))
        edges = np.linspace(0, size, min(count, size) + 1).astype(int)
        blocks = tuple(slice(int(a), int(b)) for a, b in itertools.pairwise(edges))
        object.__setattr__(self, "blocks", blocks)

    def told_N(self, rows: slice) -> Array:
        """What is fitted: the readings, a coarse converter's rounding undone, shape (rows,) [N]."""
        readings = self.reading_N[rows]
        return readings if self.rounding_N is None else readings - self.rounding_N[rows]

    def weights(self, rows: slice) -> Array:
        """Of the residuals, 0 where a reading does not count, shape (rows,)."""
        counts = self.counts[rows].astype(np.float64)
        return counts if self.trust is None else self.trust[rows] * counts

    def residual(self, rows: slice, reading_N: Array) -> tuple[Array, Array]:
        """What a simulation leaves of the readings, and how far each tells of it.

        Parameters
        ----------
        rows
            Which samples are compared.
        reading_N
            Simulated there, shape (rows,) [N].

        Returns
        -------
        residual, told
            In units of the noise, and its weights, both of shape (rows,).
        """
        error_N, told = self.told_N(rows) - reading_N, self.weights(rows)
        if self.within_N is not None:
            beyond_N = error_N - np.clip(error_N, -self.within_N[rows], self.within_N[rows])
            error_N, told = beyond_N, told * (beyond_N != 0.0)
        return np.where(told > 0.0, told * error_N, 0.0) / self.noise_N, told

    def as_judged(self) -> "Series":
        """The same without readings that an unknown past still matters for: straight pieces leave a little of it."""
        if self.past_known is None:
            return self
        return replace(self, counts=self.counts & self.past_known)

    def judges(self, block: slice) -> bool:
        """Whether a block tells of a hypothesis: one before which nothing is known fits any."""
        return self.past_known is None or bool(self.past_known[block].all())

    @property
    def dt_s(self) -> float:
        """Spacing of the samples [s]."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def duration_s(self) -> float:
        """From the first sample to the last [s]."""
        return float(self.time_s[-1])
