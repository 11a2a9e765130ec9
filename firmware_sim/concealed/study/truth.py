"""The opened truth of a study, in a form that can be compared with findings."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from firmware_sim.concealed.plant.second_input import OUTSIDE_CATALOGUE
from firmware_sim.concealed.study.seal import open_truth


@dataclass(frozen=True)
class Place:
    """Span of an axis; a spectral line has equal ends.

    Parameters
    ----------
    axis
        `time_s`, `frequency_Hz`, `rate_V_per_s`, `voltage_V` and others.
    low, high
        Ends, in the unit of the axis.
    recording
        File that a time belongs to; empty: not given.
    """

    axis: str
    low: float
    high: float
    recording: str = ""


@dataclass(frozen=True)
class TrueEffect:
    """A catalogue effect of a case."""

    name: str
    parameters: Mapping[str, float]
    where: tuple[Place, ...]
    strength: float
    scope: str


@dataclass(frozen=True)
class TrueCase:
    """The truth of one case.

    Parameters
    ----------
    kind
        One of `plan.KINDS`.
    effects
        Catalogue effects.
    foreign
        Name of the effect outside the catalogue; empty: none.
    noise_N
        Rms of the noise [N], with the noise of the voltmeter.
    family
        Family of the plant; empty: none.
    input_noise_N
        Part of `noise_N` that the voltmeter adds to a simulation [N].
    tared
        Whether every record has an offset of its own, which no simulation can know.
    """

    name: str
    kind: str
    effects: tuple[TrueEffect, ...]
    foreign: str
    noise_N: float
    family: str = ""
    input_noise_N: float = 0.0
    tared: bool = False

    @property
    def names(self) -> frozenset[str]:
        """Names of its catalogue effects."""
        return frozenset(effect.name for effect in self.effects)


def read_truth(directory: Path) -> list[TrueCase]:
    """Read every case of a study, after a check of its seal.

    Raises
    ------
    SealError
        The sealed truth is missing or was changed.
    """
    cases: Any = open_truth(directory)["cases"]
    return [_case(name, fields) for name, fields in cases.items()]


def _case(name: str, fields: Mapping[str, Any]) -> TrueCase:
    effects = tuple(_effect(effect) for effect in fields["effects"])
    foreign = "".join(effect.name for effect in effects if effect.name in OUTSIDE_CATALOGUE)
    known = tuple(effect for effect in effects if effect.name not in OUTSIDE_CATALOGUE)
    noise_N = float(fields.get("floor_N", fields["noise"]["rms_N"]))
    input_noise_N = float(fields.get("input_noise_N", 0.0))
    return TrueCase(
        name, fields["kind"], known, foreign, noise_N, fields.get("family", ""), input_noise_N, "bench" in fields
    )


def _effect(fields: Mapping[str, Any]) -> TrueEffect:
    where = tuple(Place(p["axis"], p["low"], p["high"], p.get("recording", "")) for p in fields["where"])
    return TrueEffect(fields["name"], fields["parameters"], where, fields["strength"], fields["scope"])
