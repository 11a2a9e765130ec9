"""Reads the result of a diagnosed life: `VERDICTS/case_0001/life.json` and `simulated_held_out.csv`.

`life.json` has an entry for each of the four steps of work. The table has a column for each model that was written:
`generation_0_N` of the identified model, then one for each step.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.scoring.verdicts import FLAGS, VERDICTS

SCHEMA = "piezod.life/1"
LIFE, SIMULATED = "life.json", "simulated_held_out.csv"
STEPS = 4


@dataclass(frozen=True)
class Interval:
    """95 % interval of a parameter."""

    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Whether a value is inside."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class StepVerdict:
    """Diagnosis of one step.

    Parameters
    ----------
    verdict
        One of `verdicts.VERDICTS`; `failed`: the diagnosis ended with an error.
    differences
        New, changed and gone effects and a changed base, each as `name:status`.
    given
        Effects of the given model.
    old, new
        Intervals of the changed parameters in the given and in the written model, by `effect.parameter`.
    before, simulated
        Error of the given model as the findings state it, and as a simulation of that model has it [N].
    effects
        Number of effects of the written model.
    model_bytes
        Size of its file.
    cpu_s
        Processor time of the diagnosis [s].
    """

    verdict: str
    differences: frozenset[str]
    given: frozenset[str]
    old: Mapping[str, Interval]
    new: Mapping[str, Interval]
    before: float
    simulated: float
    effects: int
    model_bytes: int
    cpu_s: float

    @property
    def flagged(self) -> bool:
        """Whether the verdict reports an unexplained remainder."""
        return self.verdict in FLAGS

    @property
    def reported_as_new(self) -> frozenset[str]:
        """Effects of the given model that are reported as new."""
        return frozenset(name for name in self.given if f"{name}:new" in self.differences)


@dataclass(frozen=True)
class LifeVerdict:
    """Diagnoses of the steps of a life, and each model's simulation of the held-out record, shape (n,) [N]."""

    steps: tuple[StepVerdict, ...]
    simulated_N: tuple[Array, ...]


def read_life(folder: Path, sealed: datetime) -> LifeVerdict | None:
    """Read the diagnoses of a life; None: there are none.

    Parameters
    ----------
    folder
        Folder of the verdict on one life.
    sealed
        Time at which the study was sealed, with a time zone.

    Raises
    ------
    StudyError
        The diagnoses are older than the seal, or break the schema.
    """
    path = folder / LIFE
    if not path.is_file():
        return None
    if path.stat().st_mtime < sealed.timestamp():
        raise StudyError(f"{path}: was written before the truth was sealed, {sealed.isoformat()}")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        return LifeVerdict(_steps(content), _simulated(folder / SIMULATED))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StudyError(f"{path}: is no {SCHEMA}: {error!r}") from error


def _steps(content: Mapping[str, Any]) -> tuple[StepVerdict, ...]:
    if content["schema"] != SCHEMA:
        raise ValueError(f"schema is {content['schema']}")
    steps = tuple(parse_step(step) for step in content["steps"])
    if len(steps) != STEPS:
        raise ValueError(f"has {len(steps)} steps")
    return steps


def parse_step(fields: Mapping[str, Any]) -> StepVerdict:
    """Build the verdict of a step from its entry in `life.json`.

    Raises
    ------
    ValueError, KeyError, TypeError
        The entry breaks the schema.
    """
    findings = fields["findings"]
    verdict = "failed" if findings is None else str(findings["verdict"])
    if verdict not in (*VERDICTS, "failed"):
        raise ValueError(f"verdict is {verdict}, must be one of {', '.join(VERDICTS)}")
    differences, old, new, before = set[str](), dict[str, Interval](), dict[str, Interval](), float("nan")
    if findings is not None:
        before = float(findings["fit"]["held_out"]["before"])
        for effect in findings["effects"]:
            differences.add(f"{effect['name']}:{effect['status']}")
            for name, value in effect["parameters"].items():
                new[f"{effect['name']}.{name}"] = _interval(value)
                if "was" in value:
                    old[f"{effect['name']}.{name}"] = _interval(value["was"])
        base = findings["base"]
        if base["status"] == "changed":
            differences.add("base:changed")
            if base["gain"] is not None:
                new["base.gain"] = _interval(base["gain"])
    return StepVerdict(
        verdict,
        frozenset(differences),
        frozenset(fields["given"]),
        old,
        new,
        before,
        float(fields["simulated_rms"]),
        int(fields["effects"]),
        int(fields["model_bytes"]),
        float(fields["cpu_s"]),
    )


def _interval(value: Mapping[str, Any]) -> Interval:
    return Interval(float(value["low"]), float(value["high"]))


def _simulated(path: Path) -> tuple[Array, ...]:
    with path.open(encoding="utf-8") as file:
        header = next(line for line in file if not line.startswith("#")).strip().split(",")
        table = np.loadtxt(file, delimiter=",", ndmin=2)
    return tuple(table[:, header.index(f"generation_{k}_N")] for k in range(STEPS + 1))
