"""Faults of the disk that the recorder writes to: its own studies and checks, in their short forms."""

import re
import subprocess
import sys
import time

from tests.faults.live import ROOT
from tests.faults.stand import CannotBeDoneHereError, Seen
from tests.studies import recorder as study


def recorded(stand, fault, *, part, amount, only=()):
    """One part of the recorder's study: what it lost of what it had acknowledged.

    Parameters
    ----------
    part
        `kills`, `cuts`, `faults` or `full`.
    amount
        How often, or for how many seconds.
    only
        Of the system calls that fail, those.
    """
    folder = stand.new_folder()
    begun_s, every = time.monotonic(), study.FAULTS
    try:
        if only:
            study.FAULTS = {name: every[name] for name in only}
        parts = {
            "kills": lambda: study.kills(folder, amount),
            "cuts": lambda: study.cuts(folder, amount),
            "faults": lambda: study.faults(folder, float(amount)),
            "full": lambda: study.full(folder, float(amount), 1),
        }
        lines = list(parts[part]())
    finally:
        study.FAULTS = every
    if skipped := [line.skipped for line in lines if line.skipped]:
        raise CannotBeDoneHereError(skipped[0])
    seen = Seen("none", text="\n".join(line.text() for line in lines), after_ms=1e3 * (time.monotonic() - begun_s))
    seen.figures = {
        "lines": len(lines),
        "failed": sum(line.failed for line in lines),
        "acknowledged": sum(line.acknowledged for line in lines),
        "rows_lost": sum(line.lost for line in lines if not line.what.startswith("the same, a CSV")),
        "rows_wrong": sum(line.wrong for line in lines),
    }
    return seen


def checked(stand, fault, *, tests):
    """Checks of the recorder that inject it: the file of tests, and words that their names have."""
    begun_s, passed, said = time.monotonic(), 0, ""
    for place, words in tests:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", place, "-k", words],
            capture_output=True, text=True, timeout=180, check=False, cwd=ROOT,
        )  # fmt: skip
        found = re.search(r"(\d+) passed", done.stdout)
        passed += int(found[1]) if found and done.returncode == 0 else 0
        said += "" if done.returncode == 0 else done.stdout[-300:]
    seen = Seen("none", text=said, after_ms=1e3 * (time.monotonic() - begun_s))
    seen.figures = {"passed": passed}
    return seen


INJECTORS = {"recorded": recorded, "checked": checked}
