"""Input and output of a peer. This file is copied beside the peer, whose environment does not contain `piezod`.

`given.json` in the current directory names the files. Each file is an `.npz` with columns of equal length: `time_s`,
`voltage_V`, `base_N` (simulation of the identified model) and further recorded columns. The held-out record has no
`force_N`. The answer is `prediction.npz` with `force_N`, and `said.json`.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

GIVEN, PREDICTION, SAID = "given.json", "prediction.npz", "said.json"
KNOWN = ("time_s", "voltage_V", "base_N", "force_N")
TRAINED = 0.8  # share of every recording for fitting; the rest compares settings


@dataclass(frozen=True)
class Record:
    """One record.

    Parameters
    ----------
    columns
        Columns by name, each of shape (n,).
    """

    columns: dict[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    @property
    def size(self) -> int:
        """Number of samples."""
        return self["time_s"].size

    @property
    def split(self) -> int:
        """First sample of the last part, on which settings are compared."""
        return int(TRAINED * self.size)

    @property
    def extra(self) -> tuple[str, ...]:
        """Names of further columns, such as `temperature_C`."""
        return tuple(sorted(set(self.columns) - set(KNOWN)))

    @property
    def missing_N(self) -> np.ndarray:
        """Residual of the identified model: measured minus simulated force, shape (n,) [N]."""
        return self["force_N"] - self["base_N"]


@dataclass(frozen=True)
class Given:
    """The case of a peer.

    Parameters
    ----------
    identification
        Recording of the identification.
    recordings
        What it shall explain.
    held_out
        What shall be predicted; without its force.
    begun_s
        Processor time when it was read: libraries are imported by then [s].
    """

    identification: Record
    recordings: tuple[Record, ...]
    held_out: Record
    begun_s: float = field(default_factory=time.process_time)


def read() -> Given:
    """Read the case in the current directory."""
    names = json.loads(Path(GIVEN).read_text(encoding="utf-8"))
    return Given(_record(names["identification"]), tuple(map(_record, names["recordings"])), _record(names["held_out"]))


def answer(given: Given, force_N: np.ndarray, terms: Sequence[str], setting: str, settings: int) -> None:
    """Write the answer.

    Parameters
    ----------
    given
        The case.
    force_N
        Of the held-out record, shape (n,) [N].
    terms
        The terms of the equation that was kept, beside the identified model; none: it says that nothing is missing.
    setting, settings
        Which was best on the last part of the recordings, and of how many.
    """
    np.savez(PREDICTION, force_N=force_N)
    busy_s = time.process_time() - given.begun_s
    said = {"terms": list(terms), "setting": setting, "settings": settings, "busy_s": round(busy_s, 3)}
    Path(SAID).write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")


def scales(records: Sequence[Record], name: str) -> tuple[float, float]:
    """Mean and spread of a column over the records; a spread of 1 where it is constant."""
    values = np.concatenate([record[name] for record in records])
    return float(values.mean()), float(values.std()) or 1.0


def _record(name: str) -> Record:
    with np.load(name, allow_pickle=False) as file:
        return Record({column: file[column].astype(np.float64) for column in file.files})
