"""Result of the last check of the model with a recorded drive, for status and metrics.

`systemd/piezod-check@.timer` starts such a check once a day.
"""

import json
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig
from piezod.config.regular_file import open_regular
from piezod.errors import PiezodError
from piezod.runtime import clock

FOLDER = "checks"  # below the folder of the recorder
LARGEST_BYTES = 1 << 24
FRESH_S = 60.0  # time for which a result is used again


@dataclass
class LastCheck:
    """The newest findings in the folder of the checks of a bench.

    Parameters
    ----------
    folder
        Folder of the checks; None: without a recorder there are none.
    """

    folder: Path | None
    name: str
    _result: dict[str, Any] | None = None
    _looked_s: float = field(default=-FRESH_S)

    @classmethod
    def of(cls, bench: BenchConfig) -> "LastCheck":
        """Last check of a bench."""
        archive = bench.recordings_path
        return cls(None if archive is None else archive / FOLDER, bench.name)

    def as_dict(self) -> dict[str, Any] | None:
        """Date of the drive (UTC), age of it [s], verdict and words; None: no check was made."""
        now_s = clock.monotonic()
        if now_s - self._looked_s >= FRESH_S:
            self._looked_s, self._result = now_s, self._newest()
        if self._result is None:
            return None
        date = datetime.fromisoformat(self._result["drive_utc"])
        return self._result | {"age_s": clock.wall_s() - date.timestamp()}

    def _newest(self) -> dict[str, Any] | None:
        """Newest findings that can be read; a folder's name ends in the time of its drive."""
        if self.folder is None:
            return None
        for path in sorted(self.folder.glob(f"{self.name}-*T*/findings.json"), reverse=True):
            try:
                date = datetime.strptime(path.parent.name.rpartition("-")[2], "%Y%m%dT%H%M%S").replace(tzinfo=UTC)
                with open_regular(path, LARGEST_BYTES) as file:
                    findings = json.load(file)
                verdict, words = str(findings["verdict"]), str(findings["words"])
            except (PiezodError, OSError, ValueError, KeyError, TypeError):
                continue
            return {"drive_utc": date.isoformat(), "verdict": verdict, "words": words, "folder": str(path.parent)}
        return None


def check_text(check: dict[str, Any]) -> str:
    """Line of `piezod status` on the last check."""
    if check["verdict"] == "matches":
        return f"last check: the model holds, drive of {check['drive_utc'][:16]}"
    return f"last check: {check['words']}; drive of {check['drive_utc'][:16]}; see {check['folder']}/report.html"
