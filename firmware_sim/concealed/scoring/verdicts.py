"""Reads the result of a diagnosis of one case: `VERDICTS/case_0001/findings.json` and two simulations beside it.

`simulated_held_out.csv` is the held-out record as simulated by the extended model, `simulated_held_out_base.csv` that
of the model without effects. Both have the columns `time_s` and `force_N`; tones and single events are left out. The
optional file `run.json` holds the duration of the diagnosis: `{"elapsed_s": 7.1}`.
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
from firmware_sim.concealed.study.seal import SEAL
from firmware_sim.concealed.study.truth import Place

SCHEMA = "piezod.findings/2"
SCHEMAS = ("piezod.findings/1", SCHEMA)  # the second has all of the first in its place
FINDINGS = "findings.json"
EXTENDED, BASE = "simulated_held_out.csv", "simulated_held_out_base.csv"
VERDICTS = ("matches", "explained", "partly_explained", "unexplained", "not_testable")
FLAGS = frozenset({"partly_explained", "unexplained"})


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the diagnosis named."""

    name: str
    confidence: float
    parameters: Mapping[str, float]
    where: tuple[Place, ...]
    rivals: frozenset[str]


@dataclass(frozen=True)
class Verdict:
    """Findings on one case.

    Parameters
    ----------
    verdict
        One of `VERDICTS`.
    where
        Places of the whole mismatch.
    elapsed_s
        Duration of the diagnosis [s]; None: not reported.
    """

    verdict: str
    effects: tuple[NamedEffect, ...]
    where: tuple[Place, ...]
    elapsed_s: float | None = None

    @property
    def names(self) -> frozenset[str]:
        """Names of the named effects."""
        return frozenset(effect.name for effect in self.effects)

    @property
    def flagged(self) -> bool:
        """Whether the verdict reports an unexplained remainder."""
        return self.verdict in FLAGS


def sealed_at(directory: Path) -> datetime:
    """Time at which a study was sealed."""
    seal = json.loads((directory / SEAL).read_text(encoding="utf-8"))
    return datetime.fromisoformat(seal["made"])


def read_verdict(folder: Path, sealed: datetime) -> Verdict | None:
    """Read the findings in the folder of a case; None: there are none.

    Parameters
    ----------
    folder
        Folder of the verdict on one case.
    sealed
        Time at which the study was sealed, with a time zone.

    Raises
    ------
    StudyError
        The findings are older than the seal, or break the schema.
    """
    path = folder / FINDINGS
    if not path.is_file():
        return None
    if path.stat().st_mtime < sealed.timestamp():
        written = datetime.fromtimestamp(path.stat().st_mtime, sealed.tzinfo).isoformat()
        raise StudyError(f"{path}: was written {written}, before the truth was sealed, {sealed.isoformat()}")
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        return parse_findings(fields, _elapsed_s(folder))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StudyError(f"{path}: is no {SCHEMA}: {error!r}") from error


def parse_findings(fields: Mapping[str, Any], elapsed_s: float | None = None) -> Verdict:
    """Build a verdict from the content of `findings.json`.

    Parameters
    ----------
    fields
        Content of `findings.json`.
    elapsed_s
        Duration of the diagnosis [s]; None: not measured.

    Raises
    ------
    ValueError, KeyError, TypeError
        The content breaks the schema.
    """
    if fields["schema"] not in SCHEMAS:
        raise ValueError(f"schema is {fields['schema']}")
    if fields["verdict"] not in VERDICTS:
        raise ValueError(f"verdict is {fields['verdict']}, must be one of {', '.join(VERDICTS)}")
    effects = tuple(_named(effect) for effect in fields["effects"])
    return Verdict(fields["verdict"], effects, _places(fields.get("where", [])), elapsed_s)


def read_simulation(path: Path, samples: int) -> Array | None:
    """Read simulated forces of the held-out record, shape (samples,) [N]; None: there is no file.

    Parameters
    ----------
    path
        CSV file with the column `force_N`.
    samples
        Number of samples of the held-out record.

    Raises
    ------
    StudyError
        The column is missing, or the number of samples differs.
    """
    if not path.is_file():
        return None
    with path.open(encoding="utf-8") as file:
        header = next((line for line in file if not line.startswith("#")), "").strip().split(",")
        if "force_N" not in header:
            raise StudyError(f"{path}: has no column force_N, has {', '.join(header)}")
        force_N = np.loadtxt(file, delimiter=",", usecols=header.index("force_N"), ndmin=1)
    if force_N.size != samples:
        raise StudyError(f"{path}: has {force_N.size} samples, the held-out record has {samples}")
    return force_N


def _elapsed_s(folder: Path) -> float | None:
    path = folder / "run.json"
    return float(json.loads(path.read_text(encoding="utf-8"))["elapsed_s"]) if path.is_file() else None


def _named(fields: Mapping[str, Any]) -> NamedEffect:
    parameters = {name: float(value["value"]) for name, value in fields.get("parameters", {}).items()}
    rivals = frozenset(rival["name"] for rival in fields.get("rivals", []))
    return NamedEffect(
        fields["name"], float(fields["confidence"]), parameters, _places(fields.get("where", [])), rivals
    )


def _places(fields: list[Mapping[str, Any]]) -> tuple[Place, ...]:
    """Places whose ends are numbers; others (a direction) are left out."""
    found = []
    for place in fields:
        low, high = place.get("low"), place.get("high")
        if isinstance(low, (int, float)) and isinstance(high, (int, float)):
            found.append(Place(place["axis"], float(low), float(high), Path(str(place.get("recording", ""))).name))
    return tuple(found)
