"""The inverse chain: from the force wanted to the voltage, planned first and committed with what was applied."""

from collections.abc import Collection
from typing import Protocol

from piezod.model.extended_compensator import ExtendedCompensator, acting_effects
from piezod.model.parameters import Model
from piezod.model.plant import Plant
from piezod.operators import ImplicitInverse
from piezod.operators.prandtl_ishlinskii import commit_step, plan_step


class Compensator(Protocol):
    """What the tick asks of every compensation."""

    def reset(self) -> None:
        """Back to the start state."""
        ...

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N]; moves no state."""
        ...

    def commit(self, voltage_V: float) -> None:
        """Move every state with the voltage that was really written."""
        ...


class InverseCompensator:
    """The model's inverse.

    Parameters
    ----------
    model
        What was identified; the states start in its start state.

    Raises
    ------
    ModelError
        The model has no inverse.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        self._packed = ImplicitInverse(model.operator()).packed

    def reset(self) -> None:
        """Back to the model's start state."""
        self._packed[:] = ImplicitInverse(self._model.operator()).packed

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N]; moves no state."""
        return plan_step(self._packed, reference)

    def commit(self, voltage_V: float) -> None:
        """Move the plays with the voltage that was really written."""
        commit_step(self._packed, voltage_V)


class GainCompensator:
    """One factor between force and voltage, the chord of the steady major loop: what one has without a model."""

    def __init__(self, model: Model) -> None:
        bottom, top = Plant(model).steady_range()
        self._slope = (model.input.high - model.input.low) / (top - bottom)
        self._offset = model.input.low - self._slope * bottom

    def reset(self) -> None:
        """Nothing is kept."""

    def plan(self, reference: float) -> float:
        """Voltage [V] for a reference [N]."""
        return self._offset + self._slope * reference

    def commit(self, voltage_V: float) -> None:
        """Nothing is kept."""


class DirectDrive:
    """The reference is the voltage: how an excitation is driven through the bench to be recorded."""

    def reset(self) -> None:
        """Nothing is kept."""

    def plan(self, reference: float) -> float:
        """The reference itself [V]."""
        return reference

    def commit(self, voltage_V: float) -> None:
        """Nothing is kept."""


def make_compensator(kind: str, model: Model, dt_s: float, without: Collection[str] = ()) -> Compensator:
    """Build the compensation that the bench configuration names: `inverse` or `gain`.

    Parameters
    ----------
    kind
        `inverse`: of the hysteresis and of the effects that the model has.
    model
        What was identified, or diagnosed.
    dt_s
        Tick period [s].
    without
        Effects of the model that are knowingly not driven against.

    Raises
    ------
    ModelError
        The model, or an effect of it, has no inverse.
    """
    if kind == "gain":
        return GainCompensator(model)
    if kind == "inverse":
        if acting_effects(model, without):
            return ExtendedCompensator(model, dt_s, without)
        return InverseCompensator(model)
    raise ValueError(f"no compensation is called {kind!r}")
