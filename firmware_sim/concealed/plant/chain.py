"""One concealed plant: the chain from the commands of a record to what its reader would show without noise.

    command -> clamp, slew, lag -> hysteresis -> creep, drifting gain -> force law, gap, friction -> temperature, load
    -> mode, vibration -> leakage, low-pass, cross-talk, hum -> delay, the reader's clock

All on a grid some times finer than the record. What happens once is in the effect's details; what is random besides
(phases, wander) comes from the record's own seed.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.cell import samples
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.force import true_force
from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.plant.hysteresis import Hysteresis
from firmware_sim.concealed.plant.mechanics import ForceLaw
from firmware_sim.concealed.plant.passage import Effects, Passage, Signal
from firmware_sim.concealed.plant.stroke import free_stroke, hysteretic_stroke, output_voltage

UPSTREAM = frozenset(
    {"voltage_clamp", "slew_limit", "electrical_lag", "rate_dependent_hysteresis", "noncongruent_minor_loops"}
    | {name for name, foreign in FOREIGN.items() if foreign.stage == "amplifier"}
)
"""Effects that the hysteresis' output depends on."""

REMEMBERED = 3


@dataclass(frozen=True)
class Plant:
    """What stays the same whatever effect is on.

    The hysteresis takes most of the time, and most effects act behind it: its last outputs are remembered.

    Parameters
    ----------
    hysteresis, noncongruent
        The operator, and the one that takes over a share of it when minor loops shall not be congruent.
    law
        From relative stroke to force.
    """

    hysteresis: Hysteresis
    noncongruent: Hysteresis
    law: ForceLaw
    _remembered: dict[Hashable, tuple[Signal, Signal]] = field(
        default_factory=dict, init=False, compare=False, repr=False
    )

    def reading_N(self, drive: Drive, effects: Effects, seed: int) -> Array:
        """Noise-free readings of a record that starts at rest, shape (n,) [N].

        Parameters
        ----------
        drive
            The record's commands.
        effects
            Those that are on.
        seed
            Of what is random in this record besides noise.
        """
        at = Passage(drive, effects, self.hysteresis.reach_V, self.law.full_N, seed)
        voltage, stroke = self._driven(at)
        return samples(at, true_force(at, self.law, free_stroke(at, stroke)), voltage)

    def _driven(self, at: Passage) -> tuple[Signal, Signal]:
        """Voltage at the stack and the hysteresis' output."""
        upstream = [repr(effect) for name, effect in sorted(at.effects.items()) if name in UPSTREAM]
        key = (id(at.drive), at.seed, *upstream)
        if key not in self._remembered:
            voltage = output_voltage(at)
            found = voltage, hysteretic_stroke(at, self.hysteresis, self.noncongruent, voltage)
            while len(self._remembered) >= REMEMBERED:
                self._remembered.pop(next(iter(self._remembered)))
            self._remembered[key] = found
        return self._remembered[key]
