"""What a diagnosis said of the cases of a study: `VERDICTS/case_0001/findings.json` and the two simulations beside it.

`simulated_held_out.csv` and `simulated_held_out_base.csv` have the columns `time_s` and `force_N`: the held-out record
as the extended model and as the model without effects simulate it, tones and one-off events left out. `run.json`, which
may be missing, says how long the diagnosis took: `{"elapsed_s": 7.1}`.
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

SCHEMA = "piezod.findings/1"
FINDINGS = "findings.json"
EXTENDED, BASE = "simulated_held_out.csv", "simulated_held_out_base.csv"
VERDICTS = ("matches", "explained", "partly_explained", "unexplained", "not_testable")
FLAGS = frozenset({"partly_explained", "unexplained"})


@dataclass(frozen=True)
class Named:
    """An effect that was named."""

    name: str
    confidence: float
    parameters: Mapping[str, float]
    where: tuple[Place, ...]
    rivals: frozenset[str]


@dataclass(frozen=True)
class Verdict:
    """What was said of one case.

    Parameters
    ----------
    verdict
        One of `VERDICTS`.
    effects
        Those named.
    where
        Places of the whole mismatch.
    elapsed_s
        How long it took [s]; None: not said.
    """

    verdict: str
    effects: tuple[Named, ...]
    where: tuple[Place, ...]
    elapsed_s: float | None = None

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects."""
        return frozenset(effect.name for effect in self.effects)

    @property
    def flagged(self) -> bool:
        """Whether it says that something is left that has no name."""
        return self.verdict in FLAGS


def sealed_at(directory: Path) -> datetime:
    """When a study was sealed."""
    seal = json.loads((directory / SEAL).read_text(encoding="utf-8"))
    return datetime.fromisoformat(seal["made"])


def read_verdict(folder: Path, sealed: datetime) -> Verdict | None:
    """The verdict in a case's folder; None: there is none.

    Raises
    ------
    StudyError
        It is older than the seal, or no findings.
    """
    path = folder / FINDINGS
    if not path.is_file():
        return None
    if path.stat().st_mtime < sealed.timestamp():
        written = datetime.fromtimestamp(path.stat().st_mtime, sealed.tzinfo).isoformat()
        raise StudyError(f"{path}: was written {written}, before the truth was sealed, {sealed.isoformat()}")
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        return parse_findings(said, _elapsed_s(folder))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StudyError(f"{path}: is no {SCHEMA}: {error!r}") from error


def parse_findings(said: Mapping[str, Any], elapsed_s: float | None = None) -> Verdict:
    """A verdict from the content of `findings.json`.

    Raises
    ------
    ValueError, KeyError, TypeError
        It does not follow the schema.
    """
    if said["schema"] != SCHEMA:
        raise ValueError(f"schema is {said['schema']}")
    if said["verdict"] not in VERDICTS:
        raise ValueError(f"verdict is {said['verdict']}, must be one of {', '.join(VERDICTS)}")
    effects = tuple(_named(effect) for effect in said["effects"])
    return Verdict(said["verdict"], effects, _places(said.get("where", [])), elapsed_s)


def read_simulation(path: Path, samples: int) -> Array | None:
    """Simulated forces of the held-out record, shape (samples,) [N]; None: there is no file.

    Raises
    ------
    StudyError
        Another number of samples, or no such column.
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


def _named(said: Mapping[str, Any]) -> Named:
    parameters = {name: float(value["value"]) for name, value in said.get("parameters", {}).items()}
    rivals = frozenset(rival["name"] for rival in said.get("rivals", []))
    return Named(said["name"], float(said["confidence"]), parameters, _places(said.get("where", [])), rivals)


def _places(said: list[Mapping[str, Any]]) -> tuple[Place, ...]:
    """Places with two numbers as ends; a class on an axis without numbers (a direction) has none to compare."""
    found = []
    for place in said:
        low, high = place.get("low"), place.get("high")
        if isinstance(low, (int, float)) and isinstance(high, (int, float)):
            found.append(Place(place["axis"], float(low), float(high), Path(str(place.get("recording", ""))).name))
    return tuple(found)
