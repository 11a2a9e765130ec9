"""Time and memory of a diagnosis, by length of the recording and by number of tried effects.

The recordings are the emulated bench's, a lag and creep since it was identified, at 1 kHz. The limit of a length is the
shortest length's time in proportion to all samples, those of the identification included. Where the cores are shared,
the processor time tells more than the clock.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.effects import EFFECTS
from piezod.estimation.recordings.intake import load_recordings
from piezod.excitation import IDENTIFICATION, excitation
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.model import save_model
from piezod.recording import Recording, write_csv
from tests.benchmarks.table import NotMeasuredError, Row
from tests.studies.mixed_work import mixed_work

ROOT = Path(__file__).parents[2]
LENGTHS = (10_000, 30_000, 100_000, 300_000, 1_000_000)
CATALOGUES = (2, 6, 12, len(EFFECTS))
RATE_Hz, PEAK_V = 1000.0, 130.0
EFFECTS_ON = {"electrical_lag": {"time_constant_s": 0.004}, "creep": {"per_decade": 0.01}}
MINUTE = 60_000  # samples
MOST_MINUTE_s = 60.0
SHORT_s = 40.0  # shorter runs are repeated three times
WITHIN_s = 7200.0  # a run


@dataclass(frozen=True)
class Figures:
    """Figures of one diagnosis, medians over the runs."""

    seconds: float
    cpu_s: float
    resident_MiB: float
    at_start_MiB: float
    runs: int
    result: str

    @property
    def added_MiB(self) -> float:
        """Memory above that of the imports [MiB]."""
        return self.resident_MiB - self.at_start_MiB

    def note(self, samples: int) -> str:
        """Processor time, memory, and the result of the diagnosis."""
        more_kB = self.added_MiB * 1048.576 / samples
        memory = f"{self.resident_MiB:.0f} MiB, {more_kB:.2f} kB a sample above the imports"
        return f"{self.cpu_s:.1f} s of processor; {memory}; {self.result}; median of {self.runs}"


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows by length with the whole catalogue, by catalogue at 3 10^4 samples, and the minute at 1 kHz."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        past = _make_model(folder)
        _diagnosed(folder, LENGTHS[0], len(EFFECTS), again=False)  # compiled and cached
        first: Figures | None = None
        for samples in LENGTHS[: 1 if quick else None]:
            figures = _diagnosed(folder, samples, len(EFFECTS), again=not quick)
            first = first or figures
            share = (samples + past) / (LENGTHS[0] + past)
            what = f"{samples:.0e} samples, whole catalogue"
            yield _row(what, figures, first, share, samples + past)
            limit_MiB = None if figures is first else share * first.added_MiB
            limit_is = "" if figures is first else "in proportion to the first"
            yield Row("diagnose", f"{what}, above imports", "MiB", figures.added_MiB, limit_MiB, limit_is)
        if quick:
            return
        first = None
        for tried in CATALOGUES:
            figures = _diagnosed(folder, LENGTHS[1], tried, again=True)
            first = first or figures
            what = f"{LENGTHS[1]:.0e} samples, {tried} effects"
            yield _row(what, figures, first, tried / CATALOGUES[0], LENGTHS[1] + past)
        figures = _diagnosed(folder, MINUTE, len(EFFECTS), again=True)
        yield Row(
            "diagnose",
            "60 s at 1 kHz, whole catalogue, two cores",
            "s",
            figures.seconds,
            most=MOST_MINUTE_s,
            note=figures.note(MINUTE + past),
        )


def _row(what: str, figures: Figures, first: Figures, share: float, samples: int) -> Row:
    """The row of one diagnosis; its limit follows from the first of the series."""
    alone = figures is first
    limit = None if alone else share * first.seconds
    limit_is = "" if alone else "in proportion to the first"
    return Row("diagnose", what, "s", figures.seconds, limit, limit_is, note=figures.note(samples))


def _make_model(folder: Path) -> int:
    """Identify the unchanged bench; returns the number of samples of that recording."""
    path = folder / "identification.csv"
    voltage_V = excitation(IDENTIFICATION, 140.0, 1.0, 1, RATE_Hz)
    _write(path, voltage_V, {}, seed=1)
    taken = load_recordings([path], "voltage_V", "force_N", lambda *_: None)
    options = Options(plays=14, zones=6)
    found = identify(
        [one.recording for one in taken], options, "tests.benchmarks", sources=[one.source for one in taken]
    )
    save_model(found.model, folder / "model.yaml")
    return voltage_V.size


def _write(path: Path, voltage_V: np.ndarray, effects: dict[str, object], seed: int) -> None:
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": 0.1}, "effects": effects})
    force_N = Bench(scenario, seed=seed).run(voltage_V, 1.0 / RATE_Hz)
    write_csv(Recording(np.arange(force_N.size) / RATE_Hz, {"voltage_V": voltage_V, "force_N": force_N}), path)


def _diagnosed(folder: Path, samples: int, tried: int, *, again: bool) -> Figures:
    """Figures of one run, or the medians of three short runs."""
    _write(folder / "work.csv", mixed_work(3, samples / RATE_Hz, RATE_Hz, PEAK_V), EFFECTS_ON, seed=2)
    runs = [_one(folder, tried)]
    if again and runs[0]["seconds"] < SHORT_s:
        runs += [_one(folder, tried), _one(folder, tried)]
    keys = ("seconds", "cpu_s", "MiB", "at_start_MiB")
    seconds, cpu_s, most, start = (float(np.median([run[key] for run in runs])) for key in keys)
    result = f"{runs[0]['verdict']}: {', '.join(runs[0]['named']) or 'nothing'}"
    return Figures(seconds, cpu_s, most, start, len(runs), result)


def _one(folder: Path, tried: int) -> dict:
    command = [sys.executable, "-m", "tests.benchmarks.one_diagnosis", str(folder), str(tried)]
    try:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=WITHIN_s, check=False)
    except subprocess.TimeoutExpired:
        raise NotMeasuredError(f"{tried} effects: not done within {WITHIN_s:g} s") from None
    if done.returncode != 0:
        messages = done.stderr.strip().splitlines() or ["no message"]
        raise NotMeasuredError(f"{tried} effects: {messages[-1]}")
    return json.loads(done.stdout)
