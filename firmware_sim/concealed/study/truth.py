"""The opened truth of a study, in a form that can be compared with what was found."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware_sim.concealed.plant.foreign import FOREIGN
from firmware_sim.concealed.study.seal import open_truth


@dataclass(frozen=True)
class Place:
    """A stretch of an axis; a line has its two ends in one point.

    Parameters
    ----------
    axis
        `time_s`, `frequency_Hz`, `rate_V_per_s`, `voltage_V` and others.
    low, high
        Its ends, in the axis' unit.
    recording
        File that a time belongs to; empty: not said.
    """

    axis: str
    low: float
    high: float
    recording: str = ""


@dataclass(frozen=True)
class TrueEffect:
    """An effect of the catalogue that is in a case."""

    name: str
    parameters: Mapping[str, float]
    where: tuple[Place, ...]
    strength: float
    scope: str


@dataclass(frozen=True)
class TrueCase:
    """What a case is.

    Parameters
    ----------
    name, kind
        Its folder; `null`, `single`, `pair`, `triple` or `foreign`.
    effects
        Those of the catalogue.
    foreign
        The name of the effect in no catalogue; empty: there is none.
    noise_N
        Noise rms [N].
    """

    name: str
    kind: str
    effects: tuple[TrueEffect, ...]
    foreign: str
    noise_N: float

    @property
    def names(self) -> frozenset[str]:
        """Names of its effects of the catalogue."""
        return frozenset(effect.name for effect in self.effects)


def read_truth(directory: Path) -> list[TrueCase]:
    """Every case of a study whose seal is whole.

    Raises
    ------
    SealError
        The truth is not the one that was sealed.
    """
    cases: Any = open_truth(directory)["cases"]
    return [_case(name, said) for name, said in cases.items()]


def _case(name: str, said: Mapping[str, Any]) -> TrueCase:
    effects = tuple(_effect(effect) for effect in said["effects"])
    foreign = "".join(effect.name for effect in effects if effect.name in FOREIGN)
    known = tuple(effect for effect in effects if effect.name not in FOREIGN)
    return TrueCase(name, said["kind"], known, foreign, float(said["noise"]["rms_N"]))


def _effect(said: Mapping[str, Any]) -> TrueEffect:
    where = tuple(Place(p["axis"], p["low"], p["high"], p.get("recording", "")) for p in said["where"])
    return TrueEffect(said["name"], said["parameters"], where, said["strength"], said["scope"])
