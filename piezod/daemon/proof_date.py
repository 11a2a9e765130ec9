"""Date of the last proof test of the interlocks (`piezod check --proof`), and whether the next one is due.

The records are looked for once, when the daemon starts: a proof test needs the bench for itself, so that none is made
while the daemon runs.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig
from piezod.config.regular_file import open_regular
from piezod.errors import PiezodError
from piezod.runtime import clock

DAY_S = 86400.0
LARGEST_BYTES = 1 << 20  # largest record; those of a proof test have a few kilobytes


def _now() -> datetime:
    return datetime.fromtimestamp(clock.wall_s(), UTC)


@dataclass(frozen=True)
class ProofDate:
    """The last proof test that was passed.

    Parameters
    ----------
    interval_days
        Time after which the next one is due [day].
    passed_at
        Begin of the last one that was passed, UTC; None: there is no such record.
    now
        Function that returns the present time, UTC.
    """

    interval_days: float
    passed_at: datetime | None
    now: Callable[[], datetime] = _now

    @property
    def age_s(self) -> float | None:
        """Time since the last one that was passed [s]; None: there is none."""
        return None if self.passed_at is None else (self.now() - self.passed_at).total_seconds()

    @property
    def is_overdue(self) -> bool:
        """Whether the next one is due, or none was ever passed."""
        age_s = self.age_s
        return age_s is None or age_s > DAY_S * self.interval_days

    def as_dict(self) -> dict[str, Any]:
        """For `piezod status`."""
        return {
            "passed_at_utc": None if self.passed_at is None else f"{self.passed_at:%Y-%m-%dT%H:%M:%SZ}",
            "age_s": self.age_s,
            "interval_days": self.interval_days,
            "overdue": self.is_overdue,
        }


def last_proof(bench: BenchConfig, path: Path) -> ProofDate | None:
    """Look for the records of a bench; None where nobody asked for it."""
    if bench.proof is None:
        return None
    folder = path.parent / (bench.proof.folder or "")
    dates = [_passed_at(found, bench.name) for found in folder.glob(f"{bench.name}-proof-*.json")]
    return ProofDate(bench.proof.interval_days, max((one for one in dates if one is not None), default=None))


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
        return "proof test: no record of one that was passed; piezod check BENCH --proof"
    days = status["age_s"] / DAY_S
    return (
        f"proof test: OVERDUE, passed {days:.0f} days ago, due after {status['interval_days']:g}; "
        "piezod check BENCH --proof"
    )


def _passed_at(path: Path, name: str) -> datetime | None:
    """Date of a record that was passed; None for any other file."""
    try:
        with open_regular(path, LARGEST_BYTES) as file:
            record = json.load(file)
        if record["bench"] != name or record["passed"] is not True:
            return None
        return datetime.strptime(record["date_utc"], "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=UTC)
    except (PiezodError, OSError, ValueError, KeyError, TypeError):
        return None
