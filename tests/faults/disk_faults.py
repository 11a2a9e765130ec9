"""Faults of the disk of the recorder, injected by its study and its tests in short form."""

import re
import subprocess
import sys
import time

from tests.faults.bench_pool import InjectionUnavailableError, Observation
from tests.faults.live_bench import ROOT
from tests.studies import recorder as study


def recorded(pool, fault, *, part, amount, only=()):
    """Run one part of the recorder study and count the acknowledged rows that are lost.

    Parameters
    ----------
    part
        `kills`, `cuts`, `faults` or `full`.
    amount
        Number of repetitions, or duration [s].
    only
        Names of `study.FAULTS` to run; all when empty.
    """
    folder = pool.new_folder()
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
        raise InjectionUnavailableError(skipped[0])
    observed = Observation(
        "none", text="\n".join(line.text() for line in lines), after_ms=1e3 * (time.monotonic() - begun_s)
    )
    observed.figures = {
        "lines": len(lines),
        "failed": sum(line.failed for line in lines),
        "acknowledged": sum(line.acknowledged for line in lines),
        "rows_lost": sum(line.lost for line in lines if not line.what.startswith("the same, a CSV")),
        "rows_wrong": sum(line.wrong for line in lines),
    }
    return observed


def checked(pool, fault, *, tests):
    """Run existing tests that inject the fault; `tests` holds pairs of test file and pytest -k expression."""
    begun_s, passed, messages = time.monotonic(), 0, ""
    for place, words in tests:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider",
             "-m", "slow or not slow", place, "-k", words],
            capture_output=True, text=True, timeout=180, check=False, cwd=ROOT,
        )  # fmt: skip
        found = re.search(r"(\d+) passed", done.stdout)
        passed += int(found[1]) if found and done.returncode == 0 else 0
        messages += "" if done.returncode == 0 else done.stdout[-300:]
    observed = Observation("none", text=messages, after_ms=1e3 * (time.monotonic() - begun_s))
    observed.figures = {"passed": passed}
    return observed


INJECTORS = {"recorded": recorded, "checked": checked}
