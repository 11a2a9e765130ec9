"""What every stage of the chain looks at: the record's commands, the effects that are on, and what is random in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.foreign import FOREIGN, Surroundings


@dataclass(frozen=True)
class Effect:
    """One effect that is on.

    Parameters
    ----------
    name
        As in the catalogue, or of a foreign one.
    parameters
        The catalogue's, by name.
    details
        What else was drawn; no one is asked for it.
    scope
        `already_there` when the plant was identified, or `come_since`.
    """

    name: str
    parameters: dict[str, float]
    details: dict[str, object] = field(default_factory=dict)
    scope: str = "come_since"

    def number(self, detail: str) -> float:
        """A detail that is a number."""
        value = self.details[detail]
        assert isinstance(value, (int, float))
        return float(value)

    def text(self, detail: str) -> str:
        """A detail that is a word."""
        return str(self.details[detail])


Effects = Mapping[str, Effect]


class Signal(NamedTuple):
    """Values on the fine grid, and whether they still are a staircase: so they are until something smooths them."""

    values: Array
    stairs: bool


@dataclass(frozen=True)
class Passage:
    """One pass through the chain.

    Parameters
    ----------
    drive
        The record's commands.
    effects
        Those that are on.
    reach_V, full_N
        Ranges [V], [N].
    seed
        Of what is random in this record besides noise.
    """

    drive: Drive
    effects: Effects
    reach_V: float
    full_N: float
    seed: int

    def on(self, name: str) -> Effect | None:
        """An effect of the catalogue, if it is on."""
        return self.effects.get(name)

    def time_s(self, points: int) -> Array:
        """Time of the points of the fine grid, shape (n,) [s]."""
        result: Array = np.asarray(np.arange(points) * self.drive.fine_s, dtype=np.float64)
        return result

    def random(self, what: str) -> np.random.Generator:
        """Random numbers of one thing in this record, the same whatever else is on."""
        return np.random.Generator(np.random.PCG64([self.seed, *what.encode()]))

    def with_foreign(self, stage: str, values: Array) -> Array:
        """Values behind the foreign effects of a stage, shape (n,)."""
        for name, effect in self.effects.items():
            if name in FOREIGN and FOREIGN[name].stage == stage:
                dt_s = 1.0 / self.drive.rate_Hz if stage == "reading" else self.drive.fine_s
                place = Surroundings(self.drive, dt_s, self.reach_V, self.full_N, self.random(name))
                values = FOREIGN[name].apply(values, effect.parameters["amount"], effect.details, place)
        return values
