"""What every step of the chain reads: commands, active effects, ranges and random numbers of one record."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.foreign import ForeignContext
from firmware_sim.concealed.plant.second_input import OUTSIDE_CATALOGUE


@dataclass(frozen=True)
class Effect:
    """One active effect.

    Parameters
    ----------
    name
        Name in the catalogue, or of a foreign effect.
    parameters
        Parameters of the catalogue, by name; of a foreign effect its `amount`.
    details
        Further drawn values of this plant; a diagnosis need not report them.
    scope
        `already_there`: in the identification record too. `come_since`: in later records alone.
    """

    name: str
    parameters: dict[str, float]
    details: dict[str, object] = field(default_factory=dict)
    scope: str = "come_since"

    def number(self, detail: str) -> float:
        """A numeric detail."""
        value = self.details[detail]
        assert isinstance(value, (int, float))
        return float(value)

    def text(self, detail: str) -> str:
        """A textual detail."""
        return str(self.details[detail])


Effects = Mapping[str, Effect]


class Signal(NamedTuple):
    """Values on the fine grid; `held`: each is held until the next point, otherwise the signal is smooth."""

    values: Array
    held: bool


@dataclass(frozen=True)
class RecordContext:
    """What the chain reads while it simulates one record.

    Parameters
    ----------
    reach_V, full_N
        Ranges of voltage [V] and force [N].
    seed
        Seed of phases and random walks in this record.
    """

    drive: Drive
    effects: Effects
    reach_V: float
    full_N: float
    seed: int

    def on(self, name: str) -> Effect | None:
        """The effect of a name, or None while it is off."""
        return self.effects.get(name)

    def time_s(self, points: int) -> Array:
        """Times of the first `points` points of the fine grid, shape (points,) [s]."""
        result: Array = np.asarray(np.arange(points) * self.drive.fine_s, dtype=np.float64)
        return result

    def random(self, purpose: str) -> np.random.Generator:
        """Random numbers for one purpose in this record; other active effects do not change them."""
        return np.random.Generator(np.random.PCG64([self.seed, *purpose.encode()]))

    def with_foreign(self, location: str, values: Array) -> Array:
        """Values behind the foreign effects at a location in the chain, shape (n,)."""
        for name, effect in self.effects.items():
            if name in OUTSIDE_CATALOGUE and OUTSIDE_CATALOGUE[name].location == location:
                dt_s = 1.0 / self.drive.rate_Hz if location == "reading" else self.drive.fine_s
                context = ForeignContext(self.drive, dt_s, self.reach_V, self.full_N, self.random(name))
                values = OUTSIDE_CATALOGUE[name].apply(values, effect.parameters["amount"], effect.details, context)
        return values
