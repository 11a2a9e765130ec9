"""A hypothesis: its effects (terms), and a point of all its parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from piezod.arrays import Array
from piezod.effects import Effect
from piezod.estimation.recordings.series import Series

Scope = Literal["already", "since", "once"]

Setting = tuple[dict[str, float], tuple[tuple[str, float], ...]]
"""Values of an effect's searched parameters, and its choices."""


@dataclass(frozen=True)
class Term:
    """An effect in a hypothesis."""

    effect: Effect  # entry of the catalogue, or a change of the stack
    scope: Scope  # "already": acts in every recording. "since": in the recordings to explain. "once": in one recording
    series: int = -1  # number of that recording; -1 unless the scope is "once"
    choices: tuple[tuple[str, float], ...] = ()  # names and values of the parameters that take a few values only
    held: bool = False  # whether the parameters stay at their values: an effect of the given model that has not changed

    def __post_init__(self) -> None:
        object.__setattr__(self, "effect", self.effect.at(dict(self.choices)))

    def acts_on(self, number: int, series: Series) -> bool:
        """Whether the effect acts in a recording."""
        if self.scope == "once":
            return number == self.series
        return self.scope == "already" or series.role == "recording"

    @property
    def searched(self) -> tuple[str, ...]:
        """Names of the parameters that are fitted."""
        return tuple(
            parameter.name
            for parameter in self.effect.parameters
            if not self.held
            and not parameter.search.choices
            and (parameter.search.only_if is None or parameter.search.only_if in self.choices)
        )

    @property
    def weights(self) -> tuple[str, ...]:
        """Names of the fitted parameters in which the chain is linear."""
        return () if self.held else self.effect.weights


@dataclass(frozen=True)
class Point:
    """Values of all parameters of a hypothesis.

    Parameters
    ----------
    density
        Coefficients of the play columns, shape (columns,) [1].
    law
        Coefficients of the force law, shape (columns,) [N].
    offsets_N
        Offset of every recording, shape (R,); the first is 0.
    starts
        Coefficients of the columns of an unknown past, an array per recording: of the stroke [V], then of the readings
        [N]. Empty: every past is known.
    """

    density: Array
    law: Array
    offsets_N: Array
    values: tuple[Mapping[str, float], ...] = ()
    starts: tuple[Array, ...] = ()

    def of(self, recordings: Sequence[int]) -> "Point":
        """Point for some of the recordings, by their numbers."""
        starts = tuple(self.starts[k] for k in recordings) if self.starts else ()
        return replace(self, offsets_N=self.offsets_N[list(recordings)], starts=starts)

    def alike(self, other: "Point") -> bool:
        """Whether another point has a base of this size."""
        return (self.density.size, self.law.size) == (other.density.size, other.law.size)
