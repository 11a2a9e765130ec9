"""The effects that the compensator inverts, and the refusal of those that it cannot."""

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Literal

from piezod.effects import EFFECTS, Effect
from piezod.errors import ModelError
from piezod.model.parameters import Model

ActingEffects = Mapping[str, Mapping[str, float]]
"""Parameter values of the effects that act on a drive, by the name of the effect."""

COMPENSATED: Mapping[str, Literal["tick", "preview"]] = MappingProxyType(
    {
        "voltage_clamp": "tick",
        "slew_limit": "tick",
        "electrical_lag": "tick",
        "rate_dependent_hysteresis": "tick",
        "creep": "tick",
        "gain_drift": "tick",
        "output_nonlinearity": "tick",
        "contact_gap": "tick",
        "thermal_drift": "tick",
        "resonance": "preview",
        "transport_delay": "preview",
    }
)
"""The effects that `ExtendedCompensator` inverts. "tick": in the voltage and the states of every tick. "preview": in a
reference that is known ahead."""


def check_catalogue(effects: Mapping[str, Effect], compensated: Collection[str]) -> None:
    """Refuse a catalogue whose compensated effects differ from those that the compensator inverts.

    Parameters
    ----------
    effects
        Catalogue of effects, by name.
    compensated
        Names of the effects that the compensator inverts.

    Raises
    ------
    ImportError
        An effect is declared as compensated and is not inverted, or the reverse. The message names it.
    """
    declared = {name for name, effect in effects.items() if effect.handling == "compensated"}
    if missing := sorted(declared.difference(compensated)):
        raise ImportError(
            f"piezod.model: {', '.join(missing)}: the catalogue declares handling 'compensated', but the compensator "
            "has no inverse; add it to piezod/model/chain_array.py and COMPENSATED, or declare another handling"
        )
    if undeclared := sorted(set(compensated).difference(declared)):
        raise ImportError(
            f"piezod.model: {', '.join(undeclared)}: COMPENSATED lists it, but the catalogue declares another "
            "handling; declare handling 'compensated' in its effect file, or remove it from COMPENSATED"
        )


def acting_effects(model: Model, without: Collection[str] = ()) -> ActingEffects:
    """Effects of a model that act on every drive.

    Effects that belong to a single recording do not act.

    Parameters
    ----------
    model
        Identified or diagnosed model.
    without
        Names of the effects to leave out.
    """
    return {
        effect.name: effect.parameters
        for effect in model.effects
        if effect.recording is None and effect.name not in without
    }


def refuse_uncompensated(acting: Collection[str]) -> None:
    """Refuse effects that have no inverse.

    Parameters
    ----------
    acting
        Names of the effects that act on the drive.

    Raises
    ------
    ModelError
        An effect has no inverse; the message names the effect, the reason and the remedy.
    """
    for name in acting:
        if EFFECTS[name].handling == "refused":
            raise ModelError(
                f"{name} cannot be compensated: {EFFECTS[name].why}; drive without it knowingly (bench file: "
                f"compensation_without: [{name}]), or with the model that was identified"
            )


check_catalogue(EFFECTS, COMPENSATED)
