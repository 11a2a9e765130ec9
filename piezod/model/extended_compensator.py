"""The compensator of a model with effects: the inverse of the chain, and the lead of a reference known ahead."""

import math
from collections.abc import Collection

import numpy as np

from piezod.arrays import Array
from piezod.effects import EFFECTS
from piezod.model.chain.acting import refuse_uncompensated
from piezod.model.chain.tick_chain import TickChain, ticks_late
from piezod.model.chain.tick_steps import commit_chain, plan_chain
from piezod.model.law_inverse import law_inverse
from piezod.model.parameters import Model


class ExtendedCompensator:
    """Inverse of a model with its effects.

    Parameters
    ----------
    model
        Identified or diagnosed model. Effects that belong to a single recording do not act.
    without
        Names of effects that are deliberately not compensated.

    Attributes
    ----------
    delay_s
        Time from the end of a tick to the reading that shows its force [s].
    dt_s
        Tick period [s].

    Raises
    ------
    ModelError
        The model or one of its effects has no inverse; the message names the effect, the reason and the remedy.
    """

    def __init__(self, model: Model, dt_s: float, without: Collection[str] = ()) -> None:
        self.chain = TickChain(model, dt_s, without)
        refuse_uncompensated(self.chain.acting)
        self.delay_s, self.dt_s = self.chain.delay_s, dt_s
        self._program, self._state = self.chain.program, self.chain.state
        self._previews = [(p, values) for name, values in self.chain.acting.items() if (p := EFFECTS[name].preview)]
        self._law = law_inverse(model, self.chain, without)

    def reset(self) -> None:
        """Return to the model's start state at rest; the next temperature is that of the start."""
        self.chain.reset()
        if self._law is not None:
            self._law.reset()

    def plan(self, reference: float) -> float:
        """Voltage [V] for the force `reference` [N] at the end of the tick; changes no state."""
        if self._law is not None:
            return self._law.plan(reference)
        return plan_chain(self._program, self._state, reference)

    def commit(self, voltage_V: float) -> None:
        """Advance every state with the voltage `voltage_V` [V] that was written."""
        if self._law is not None:
            self._law.commit(voltage_V)
        else:
            commit_chain(self._program, self._state, voltage_V)

    def produced_N(self) -> float:
        """Force that the voltages written give by the model, before the resonance [N]."""
        added_N = 0.0 if self._law is None else self._law.added_N
        return self.chain.force_N + added_N

    def update_temperature(self, temperature_C: float) -> None:
        """Update the effects that depend on a temperature [degC]; an invalid temperature is ignored."""
        self.chain.measure(temperature_C)

    @property
    def compensates_law(self) -> bool:
        """Whether an unnamed law of the model is compensated."""
        return self._law is not None

    @property
    def preview_s(self) -> float:
        """Time by which a reference must be known ahead for the complete lead [s]."""
        return self.delay_s + self.dt_s * sum(preview.ticks for preview, _ in self._previews)

    @property
    def late_s(self) -> float:
        """Time by which readings follow a reference that is not known ahead [s]."""
        late_s = ticks_late(self.delay_s, self.chain.acting, self.dt_s) * self.dt_s
        return late_s + sum(preview.late_s(values) for preview, values in self._previews if not preview.shifts)

    @property
    def preview_ticks(self) -> int:
        """Time by which a reference must be known ahead [ticks], rounded up."""
        return math.ceil(self.preview_s / self.dt_s)

    def ahead(self, values: Array, *, loop: bool) -> Array:
        """Force to plan for, so that the readings follow `values`: led by the delay, with preview effects inverted.

        Parameters
        ----------
        values
            Reference known ahead, one value a tick, shape (N,) [N].
        loop
            Whether the values begin again at the end; otherwise the last value is held.
        """
        if self.preview_s == 0.0:
            return values
        margin = self.preview_ticks + 3
        wide = np.pad(values, margin, mode="wrap" if loop else "edge")
        ticks = np.arange(wide.size, dtype=np.float64)
        if self.delay_s > 0.0:
            wide = np.interp(ticks + ticks_late(self.delay_s, self.chain.acting, self.dt_s), ticks, wide)
        for preview, values_of_effect in reversed(self._previews):
            if preview.ahead is not None:
                wide = preview.ahead(wide, values_of_effect, self.dt_s)
        return wide[margin:-margin]
