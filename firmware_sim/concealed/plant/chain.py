"""One concealed plant: the chain from the commands of a record to its readings without noise.

- amplifier: clamp, slew limit, lag (`stroke.py`, `amplifier.py`);
- stack: hysteresis, creep, drift of the gain (`stroke.py`, `hysteresis.py`, `creep.py`);
- mechanics: force law, gap, friction, temperature, load, mode, vibration (`force.py`, `force_law.py`, `friction.py`);
- load cell: leakage, low-pass, cross-talk, hum (`load_cell.py`);
- readings: delay, clock of the readings (`load_cell.py`, `sampling.py`).

The chain runs on a grid 3 to 16 times finer than the record. Single events stand in the details of their effect. Phases
and random walks come from the seed of the record.
"""

from collections.abc import Hashable
from dataclasses import dataclass, field

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.force import true_force
from firmware_sim.concealed.plant.force_law import ForceLaw
from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.plant.hysteresis import Hysteresis
from firmware_sim.concealed.plant.load_cell import samples
from firmware_sim.concealed.plant.record_context import Effects, RecordContext, Signal
from firmware_sim.concealed.plant.stroke import free_stroke, hysteretic_stroke, output_voltage

UPSTREAM = frozenset(
    {"voltage_clamp", "slew_limit", "electrical_lag", "rate_dependent_hysteresis", "noncongruent_minor_loops"}
    | {name for name, foreign in FOREIGN.items() if foreign.location == "amplifier"}
)
"""Effects that change the output of the hysteresis."""

CACHE_SIZE = 3  # outputs of the hysteresis


@dataclass(frozen=True)
class Plant:
    """The part of a plant that no effect changes.

    The hysteresis takes most of the time, and most effects act behind it. Its last outputs are therefore cached.

    Parameters
    ----------
    hysteresis
        Rate-independent operator from voltage to stroke.
    noncongruent
        Operator that replaces a share of `hysteresis` under the effect `noncongruent_minor_loops`.
    law
        From relative stroke to force.
    """

    hysteresis: Hysteresis
    noncongruent: Hysteresis
    law: ForceLaw
    _cache: dict[Hashable, tuple[Drive, Signal, Signal]] = field(
        default_factory=dict, init=False, compare=False, repr=False
    )

    def reading_N(self, drive: Drive, effects: Effects, seed: int) -> Array:
        """Noise-free readings of a record that starts at rest, shape (n,) [N].

        Parameters
        ----------
        seed
            Seed of phases and random walks in this record; the noise has its own.
        """
        context = RecordContext(drive, effects, self.hysteresis.reach_V, self.law.full_N, seed)
        voltage, stroke = self._driven(context)
        return samples(context, true_force(context, self.law, free_stroke(context, stroke)), voltage)

    def _driven(self, context: RecordContext) -> tuple[Signal, Signal]:
        """Voltage at the stack and output of the hysteresis, on the fine grid [V]; cached."""
        upstream = [repr(effect) for name, effect in sorted(context.effects.items()) if name in UPSTREAM]
        key = (id(context.drive), context.seed, *upstream)
        if key not in self._cache:
            voltage = output_voltage(context)
            stroke = hysteretic_stroke(context, self.hysteresis, self.noncongruent, voltage)
            while len(self._cache) >= CACHE_SIZE:
                self._cache.pop(next(iter(self._cache)))
            self._cache[key] = context.drive, voltage, stroke  # the drive lives on, so that its id stays its own
        return self._cache[key][1:]
