"""The reading that a model expects, and the force corrected for the load cell.

`ExpectedReading` runs the forward chain beside the bench, with the voltages that were written. The effects of the load
cell follow it; the compensator ignores them.

    force       amplifier -> plays -> stack -> force law -> mechanics
    expected    force -> load cell -> delay; a hum is followed from tick to tick
    corrected   reading + force - expected

The correction takes the influence of the load cell from the model and everything else from the reading. It amplifies no
noise, as the inverse of a low-pass would, and integrates no error, as the inverse of a leakage would. While the reading
is frozen, the last difference stays. The result is for display and comparison; the interlocks check the raw reading.
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects import EFFECTS
from piezod.model.chain.acting import acting_effects
from piezod.model.chain.tick_chain import TickChain
from piezod.model.chain.tick_steps import read_chain
from piezod.model.parameters import Model
from piezod.model.unnamed_law import LawStep


class ExpectedReading:
    """Model that runs beside the bench.

    Parameters
    ----------
    model
        Model with its effects. Refused effects do not act; their influence is in the difference between reading and
        expected reading.

    Raises
    ------
    ModelError
        The model's operator has no inverse.
    """

    def __init__(self, model: Model, dt_s: float) -> None:
        refused = [name for name in acting_effects(model) if EFFECTS[name].handling == "refused"]
        self._chain = TickChain(model, dt_s, refused, reads=True)
        self._law = None if model.unnamed_law is None else LawStep(model.unnamed_law, dt_s)

    def reset(self) -> None:
        """Return to the model's start state at rest; estimates of amplitude and phase stay."""
        self._chain.reset()
        if self._law is not None:
            self._law.reset()

    def run(self, voltage_V: Array, reading_N: Array, temperature_C: float = math.nan) -> tuple[Array, Array]:
        """Expected readings and corrected forces, each of shape (N,) [N].

        Parameters
        ----------
        voltage_V
            Written voltages, one a tick, shape (N,) [V].
        reading_N
            Readings at the end of each tick, shape (N,) [N]; nan without a reading.
        temperature_C
            Last temperature read [degC]. It changes slowly, so one value serves all ticks.
        """
        self._chain.measure(temperature_C)
        voltage_V = np.ascontiguousarray(voltage_V, dtype=np.float64)
        reading_N = np.ascontiguousarray(reading_N, dtype=np.float64)
        expected, corrected = np.empty(voltage_V.size), np.empty(voltage_V.size)
        read_chain(self._chain.program, self._chain.state, voltage_V, reading_N, expected, corrected)
        if self._law is not None:
            expected += self._law.run(voltage_V, expected)
        return expected, corrected
