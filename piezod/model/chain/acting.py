"""The effects of a model that act, in the order of the signal chain."""

from collections.abc import Collection, Mapping

from piezod.effects import EFFECTS, Effect
from piezod.errors import ModelError
from piezod.model.parameters import Model
from piezod.model.unnamed_law import NAME

ActingEffects = Mapping[str, Mapping[str, float]]
"""Parameter values of the effects that act on a drive, by the name of the effect."""


def acting_effects(model: Model, without: Collection[str] = ()) -> ActingEffects:
    """Effects of a model that act on every drive.

    Effects that belong to a single recording do not act.

    Parameters
    ----------
    without
        Names of the effects to leave out.
    """
    acting = {entry.name: entry.parameters for entry in model.effects if entry.recording is None}
    return {name: acting[name] for name in EFFECTS if name in acting and name not in without}


def without_inverse(model: Model) -> list[str]:
    """Names of acting effects that cannot be compensated, and of an unnamed law with modes."""
    names = [name for name in acting_effects(model) if EFFECTS[name].handling == "refused"]
    return [*names, NAME] if model.unnamed_law is not None and model.unnamed_law.modes else names


def acting_in(model: Model, sha256: str | None) -> list[tuple[Effect, Mapping[str, float]]]:
    """Effects of a model that act in a recording, with their values.

    Parameters
    ----------
    sha256
        SHA-256 of the recording's file. Effects that belong to another recording do not act.
    """
    order = {name: place for place, name in enumerate(EFFECTS)}
    acting = [entry for entry in model.effects if entry.recording is None or entry.recording == sha256]
    ordered = sorted(acting, key=lambda entry: order[entry.name])
    return [(EFFECTS[entry.name].at(entry.parameters), entry.parameters) for entry in ordered]


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
