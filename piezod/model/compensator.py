"""Compensators: they plan a voltage for a reference without a change of state, then commit the voltage written."""

import math
from collections.abc import Collection
from typing import Protocol

import numpy as np

from piezod.model.chain.acting import acting_effects
from piezod.model.extended_compensator import ExtendedCompensator
from piezod.model.parameters import Model
from piezod.model.reach import steady_range
from piezod.operators import ImplicitInverse
from piezod.operators.prandtl_ishlinskii import commit_step, output_of, plan_step


class Compensator(Protocol):
    """Conversion of a reference into a voltage, once a tick: `plan`, then `commit`."""

    def reset(self) -> None:
        """Return to the start state."""
        ...

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N]; changes no state."""
        ...

    def commit(self, voltage_V: float) -> None:
        """Advance every state with the voltage `voltage_V` [V] that was written."""
        ...

    def produced_N(self) -> float:
        """Force that the voltages written give by the model [N]; nan without a model of it."""
        ...


class InverseCompensator:
    """Inverse of a model without effects.

    Parameters
    ----------
    model
        Identified model; the states begin in its start state.

    Raises
    ------
    ModelError
        The model has no inverse.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._packed = ImplicitInverse(model.operator()).packed
        self._zones = np.concatenate(model.operator().dead_zones)

    def reset(self) -> None:
        """Return to the model's start state."""
        self._packed[:] = ImplicitInverse(self._model.operator()).packed

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N]; changes no state."""
        return plan_step(self._packed, reference)

    def commit(self, voltage_V: float) -> None:
        """Advance the plays with the voltage `voltage_V` [V] that was written."""
        commit_step(self._packed, voltage_V)

    def produced_N(self) -> float:
        """Force that the voltages written give by the model [N]."""
        return output_of(self._packed, self._zones)


class GainCompensator:
    """Linear conversion by the chord of the steady major loop: a comparison without compensation of the hysteresis."""

    def __init__(self, model: Model) -> None:
        bottom, top = steady_range(model)
        self._slope = (model.input.high - model.input.low) / (top - bottom)
        self._offset = model.input.low - self._slope * bottom
        self._voltage_V = math.nan

    def reset(self) -> None:
        """Forget the voltage written."""
        self._voltage_V = math.nan

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N]."""
        return self._offset + self._slope * reference

    def commit(self, voltage_V: float) -> None:
        """Keep the voltage `voltage_V` [V] that was written, for `produced_N`."""
        self._voltage_V = voltage_V

    def produced_N(self) -> float:
        """Force on the chord at the voltage written [N]; nan before the first."""
        return (self._voltage_V - self._offset) / self._slope


class DirectDrive:
    """The reference is the voltage, as in the recording of an excitation."""

    def reset(self) -> None:
        """No effect: there is no state."""

    def plan(self, reference: float) -> float:
        """Voltage [V]: the reference itself."""
        return reference

    def commit(self, voltage_V: float) -> None:
        """No effect: there is no state."""

    def produced_N(self) -> float:
        """nan: a direct drive has no model."""
        return math.nan


def make_compensator(kind: str, model: Model, dt_s: float, without: Collection[str] = ()) -> Compensator:
    """Build the compensator that the bench configuration names.

    Parameters
    ----------
    kind
        "inverse": inverse of the hysteresis and of the model's effects. "gain": linear conversion.
    without
        Names of effects that are deliberately not compensated.

    Raises
    ------
    ModelError
        The model, or one of its effects, has no inverse.
    """
    if kind == "gain":
        return GainCompensator(model)
    if kind == "inverse":
        if acting_effects(model, without) or model.unnamed_law is not None:
            return ExtendedCompensator(model, dt_s, without)
        return InverseCompensator(model)
    raise ValueError(f"compensation is {kind!r}, must be 'inverse' or 'gain'")
