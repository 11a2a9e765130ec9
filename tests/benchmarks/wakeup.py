"""Lateness of the rate keeper at 1 kHz, beside cyclictest with the same priority."""

import shutil
import subprocess
import warnings
from collections.abc import Callable, Iterator

import numpy as np

from piezod.config import RealTimeConfig
from piezod.control import RealTimeWarning
from piezod.control.latency import measure_lateness
from tests.benchmarks.rounds import PERCENTILES, ROUNDS, Figures, alternate, percentiles
from tests.benchmarks.table import NotMeasuredError, Row

RATE_HZ = 1000.0
PRIORITY = 80
MOST_RATIO = 1.3


def measure(*, quick: bool) -> Iterator[Row]:
    """Median and p99 [us]; the rounds of both alternate."""
    duration_s, rounds = (0.2, ROUNDS) if quick else (2.0, 2 * ROUNDS + 1)
    notes: set[str] = set()
    actions: dict[str, Callable[[], Figures]] = {"ours": lambda: _keeper_us(duration_s, notes)}
    try:
        _cyclictest_us(0.01)
        actions["cyclictest"] = lambda: _cyclictest_us(duration_s)
    except NotMeasuredError as reason:
        notes.add(f"limit: not measured: {reason}")
    found = alternate(actions, rounds)
    for k, q in enumerate(PERCENTILES):
        limit = float(found["cyclictest"][k]) if "cyclictest" in found else None
        yield Row(
            "wakeup",
            f"lateness at 1 kHz, p{q}",
            "us",
            float(found["ours"][k]),
            limit,
            f"cyclictest -m -p{PRIORITY}",
            most_ratio=MOST_RATIO,
            note="; ".join(sorted(notes)),
        )


def _keeper_us(duration_s: float, notes: set[str]) -> Figures:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        measured = measure_lateness(RATE_HZ, duration_s, RealTimeConfig(fifo_priority=PRIORITY))
    notes.update(str(one.message) for one in caught if issubclass(one.category, RealTimeWarning))
    return percentiles(measured.lateness_us)


def _cyclictest_us(duration_s: float) -> Figures:
    """Percentiles of the histogram of cyclictest, with buckets of 1 us, rounded down.

    Raises
    ------
    NotMeasuredError
        It is not installed or may not run.
    """
    program = shutil.which("cyclictest")
    if program is None:
        raise NotMeasuredError("cyclictest is not installed")
    loops = round(duration_s * RATE_HZ)
    command = [program, "-q", "-m", f"-p{PRIORITY}", f"-i{1e6 / RATE_HZ:.0f}", f"-l{loops}", "-h20000"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line.split() for line in done.stdout.splitlines() if line[:1].isdigit()]
    if done.returncode != 0 or not lines:
        raise NotMeasuredError(f"cyclictest: {(done.stderr or done.stdout).strip()[:80]}")
    return percentiles(np.repeat([int(line[0]) + 0.5 for line in lines], [int(line[1]) for line in lines]))
