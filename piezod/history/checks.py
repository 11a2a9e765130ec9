"""Checks of models: folders that `piezod diagnose` has written, also where the given model stays."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from piezod.config.regular_file import open_regular
from piezod.errors import ConfigurationError

LARGEST_BYTES = 1 << 24  # of findings
STAMP = "%Y%m%dT%H%M%S"  # end of the name of a folder of the daily check


@dataclass(frozen=True)
class Check:
    """A diagnosis: its folder, date in UTC, verdict and words.

    The date is the end of the folder's name, as the daily check writes it, else the date of the file.
    """

    folder: Path
    date: str
    verdict: str
    words: str
    findings: Mapping[str, Any] = field(repr=False)

    @property
    def dated(self) -> tuple[datetime, Mapping[str, Any]]:
        """Date and findings."""
        return datetime.fromisoformat(self.date), self.findings

    def as_dict(self) -> dict[str, Any]:
        """The check for JSON."""
        return {"folder": str(self.folder), "date": self.date, "verdict": self.verdict, "words": self.words}


def find_checks(paths: Sequence[Path]) -> list[Check]:
    """Checks in folders and their subfolders, one level deep, by the date of their recording.

    Raises
    ------
    ConfigurationError
        A folder cannot be read.
    """
    try:
        places = {
            place
            for path in paths
            if path.is_dir()
            for place in (path, *path.iterdir())
            if (place / "findings.json").is_file()
        }
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: cannot be read: {error.strerror}") from error
    checks = [check for place in places if (check := _read(place)) is not None]
    return sorted(checks, key=lambda check: (check.date, str(check.folder)))


def checks_text(checks: Sequence[Check]) -> str:
    """A line for each check."""
    return "\n".join(
        f"check {check.date[:16].replace('T', ' ')} {check.folder.name}: {check.words}" for check in checks
    )


def _read(place: Path) -> Check | None:
    """Check in a folder; None if the file is no list of findings."""
    path = place / "findings.json"
    try:
        with open_regular(path, LARGEST_BYTES) as file:
            findings = json.load(file)
        stamp = place.name.rpartition("-")[2]
        try:
            date = datetime.strptime(stamp, STAMP).replace(tzinfo=UTC)
        except ValueError:
            date = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        return Check(
            place, date.isoformat(timespec="seconds"), str(findings["verdict"]), str(findings["words"]), findings
        )
    except (ConfigurationError, OSError, ValueError, KeyError, TypeError, RecursionError):
        return None
