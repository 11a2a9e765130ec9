"""Last proof test of the interlocks (`piezod check --proof`), and whether the next one is due.

A proof test proves the limits, arming, tick rate and links that the bench had then. Its record holds a hash of each
(`proven_sections`): after a change of one the next proof test is due. The last record with steps counts, if its date is
not in the future. After one that was not passed the next one is due.

The records are looked for once, when the daemon starts: a proof test needs the bench for itself, so that none is made
while the daemon runs. A reload that changes a limit shows at once.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig
from piezod.config.regular_file import open_regular
from piezod.errors import PiezodError
from piezod.runtime import clock

SCHEMA = "piezod.proof/1"
DATE = "%Y-%m-%dT%H:%M:%SZ"
DAY_S = 86400.0
LARGEST_BYTES = 1 << 20  # largest record; those of a proof test have a few kilobytes
PROVEN = ("rate_Hz", "link", "load_cell_link", "limits", "arming")  # keys of the bench file that a proof test proves


def _now() -> datetime:
    return datetime.fromtimestamp(clock.wall_s(), UTC)


def proven_sections(bench: BenchConfig) -> dict[str, str]:
    """SHA-256 of the value of each key that a proof test proves; a key without a value has none."""
    values = bench.model_dump(mode="json", include=set(PROVEN), exclude_none=True)
    texts = {key: json.dumps(value, sort_keys=True) for key, value in values.items()}
    return {key: hashlib.sha256(text.encode()).hexdigest() for key, text in texts.items()}


@dataclass(frozen=True)
class ProofDate:
    """The last proof test, if it was passed.

    Parameters
    ----------
    interval_days
        Time after which the next one is due [day].
    passed_at
        Begin of the last one, UTC; None: it was not passed, or there is no record.
    proven
        `proven_sections` of the bench then.
    present
        Function that returns `proven_sections` of the bench now.
    now
        Function that returns the present time, UTC.
    """

    interval_days: float
    passed_at: datetime | None
    proven: Mapping[str, str] = field(default_factory=dict)
    present: Callable[[], Mapping[str, str]] = dict
    now: Callable[[], datetime] = _now

    @property
    def changed(self) -> list[str]:
        """Keys of the bench file that the last one does not prove any more."""
        present = {} if self.passed_at is None else self.present()
        return [key for key in PROVEN if present.get(key) != self.proven.get(key)] if present else []

    @property
    def age_s(self) -> float | None:
        """Time since the last one [s]; None: it was not passed, it proves another bench, or there is none."""
        return None if self.passed_at is None or self.changed else (self.now() - self.passed_at).total_seconds()

    @property
    def is_overdue(self) -> bool:
        """Whether the next one is due; also if the clock shows a time before the last one."""
        age_s = self.age_s
        return age_s is None or not 0.0 <= age_s <= DAY_S * self.interval_days

    def as_dict(self) -> dict[str, Any]:
        """For `piezod status`."""
        return {
            "passed_at_utc": None if self.passed_at is None else f"{self.passed_at:{DATE}}",
            "age_s": self.age_s,
            "changed": self.changed,
            "interval_days": self.interval_days,
            "overdue": self.is_overdue,
        }


def last_proof(bench: BenchConfig, path: Path, present: Callable[[], BenchConfig]) -> ProofDate | None:
    """Look for the records of a bench; None where nobody asked for it.

    Parameters
    ----------
    path
        Bench file.
    present
        Function that returns the bench that a reload may have changed.
    """
    if bench.proof is None:
        return None
    records = proof_records(path.parent / (bench.proof.folder or ""), bench.name)
    now = f"{_now():{DATE}}"
    last = next((one for one in reversed(records) if one["date_utc"] <= now and one["steps"]), None)
    if last is None or not _has_passed(last):
        return ProofDate(bench.proof.interval_days, None)
    return ProofDate(bench.proof.interval_days, _date(last), last.get("proven", {}), lambda: proven_sections(present()))


def proof_records(folder: Path, name: str) -> list[dict[str, Any]]:
    """Records of a bench by their date, the oldest first; other files are ignored.

    Parameters
    ----------
    folder
        Folder of the records, `proof.folder`.
    name
        Name of the bench.
    """
    records = [_record(path, name) for path in folder.glob(f"{name}-proof-*.json")]
    return sorted((one for one in records if one is not None), key=lambda record: str(record["date_utc"]))


def proof_text(status: dict[str, Any]) -> str:
    """Line of `piezod status` on a proof test that is due; empty: none is.

    Parameters
    ----------
    status
        As `ProofDate.as_dict` makes it.
    """
    if not status["overdue"]:
        return ""
    if status["passed_at_utc"] is None:
        return "proof test: no record of one that was passed, or the last one was not; piezod check BENCH --proof"
    if status["changed"]:
        keys = ", ".join(status["changed"])
        return f"proof test: DUE, {keys} changed since {status['passed_at_utc']}; piezod check BENCH --proof"
    days = status["age_s"] / DAY_S
    return (
        f"proof test: OVERDUE, passed {days:.0f} days ago, due after {status['interval_days']:g}; "
        "piezod check BENCH --proof"
    )


def _has_passed(record: dict[str, Any]) -> bool:
    """Whether a record says that it has passed, and its steps say so too."""
    results = {step["result"] for step in record["steps"]}
    return record.get("passed") is True and "pass" in results and results <= {"pass", "skipped"}


def _date(record: dict[str, Any]) -> datetime:
    return datetime.strptime(record["date_utc"], DATE).replace(tzinfo=UTC)


def _record(path: Path, name: str) -> dict[str, Any] | None:
    """A record of the bench; None for any other file."""
    try:
        with open_regular(path, LARGEST_BYTES) as file:
            record: dict[str, Any] = json.load(file)
        named = (record["schema"], record["bench"], f"{_date(record):{DATE}}") == (SCHEMA, name, record["date_utc"])
        known = isinstance(record.get("proven", {}), dict) and all(_is_step(step) for step in record["steps"])
    except (PiezodError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    return record if named and known else None


def _is_step(step: dict[str, Any]) -> bool:
    numbers = [step["measured"], step["limit"]]
    known = all(value is None or (isinstance(value, int | float) and isfinite(value)) for value in numbers)
    return known and isinstance(step["name"], str) and isinstance(step["result"], str)
