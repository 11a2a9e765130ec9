"""Archives of recordings of concealed benches: a fleet of ten benches, and one bench over a year.

    python -m tests.studies fleet /tmp/fleet
    python -m tests.studies year /tmp/year

Each study writes an archive, a folder for each bench with its identified model and its recordings. Then it runs
`piezod history` on it, and prints what that says, its processor time, and the truth. All benches are drawn by
`firmware_sim.concealed`. The fleet has one type of stack, whose gains differ by 1 %.
"""

import argparse
import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.study.case import Case, Record
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.entry import COME_SINCE
from firmware_sim.concealed.study.lives import work_record
from firmware_sim.concealed.study.make import write_record
from piezod.blind.case import Description
from piezod.blind.diagnose_case import identified
from piezod.diagnose.verdict.information import identified_information
from piezod.estimation.recordings.sources import read_source
from piezod.model import save_model

FIRST_DAY = datetime(2025, 1, 6, 8, tzinfo=UTC)
GAIN_SPREAD = 0.01  # standard deviation of the gains of a fleet
CREEP_PER_MONTH = 1.03
WEEKS_PER_MONTH = 52 / 12
REPAIR_WEEK, REPAIR_GAIN = 27, 1.04
COLD_WEEK, COLD_K, GAIN_PER_K = 41, -15.0, 0.0015

BenchAt = Callable[[int], Case]
"""Bench at a recording, counted from 1; 0: at its identification."""


def bench_with_creep(family: str, seed: int) -> Case:
    """A drawn bench with creep of 20 times its noise."""
    spec = CaseSpec("single", ("creep",), (20.0,), "white", family)
    case = draw_case(spec, np.random.SeedSequence(seed))
    return replace(case, effects={name: replace(on, scope=COME_SINCE) for name, on in case.effects.items()})


def with_gain(case: Case, factor: float) -> Case:
    """The bench with another gain of its stack."""
    law = replace(case.plant.law, full_N=case.plant.law.full_N * factor)
    return replace(case, plant=Plant(case.plant.hysteresis, case.plant.noncongruent, law))


def with_creep(case: Case, factor: float) -> Case:
    """The bench with so many times its creep; 0: without creep."""
    if factor == 0.0:
        return replace(case, effects={})
    on = case.effects["creep"]
    scaled = replace(on, parameters=on.parameters | {"per_decade": factor * on.parameters["per_decade"]})
    return replace(case, effects={"creep": scaled})


def write_bench(folder: Path, at: BenchAt, count: int, seconds: float, days: float, rng: np.random.Generator) -> None:
    """Write a bench's folder: the model of its identification, and `count` recordings of work with their dates."""
    folder.mkdir(parents=True)
    first = at(0)
    identification = replace(first.records[0], seed=int(rng.integers(2**40)))
    _write(folder / "identification.csv", first, replace(identification, name="identification.csv"), FIRST_DAY)
    _identify(folder)
    (folder / "identification.csv").unlink()
    for number in range(1, count + 1):
        case = at(number)
        record = work_record(case, number, rng, seconds)
        if number == COLD_WEEK and case.truth.get("cold"):
            record = replace(record, drive=replace(record.drive, temperature_C=record.drive.temperature_C + COLD_K))
        _write(folder / record.name, case, record, FIRST_DAY + timedelta(days=days * number))


def fleet(folder: Path, benches: int, recordings: int, seconds: float, seed: int) -> dict[str, str]:
    """Write the archive of a fleet; return what is special about some benches, by name."""
    rng = np.random.default_rng(seed)
    case = bench_with_creep("plays", seed)
    gains = 1.0 + GAIN_SPREAD * rng.normal(size=benches)
    half = recordings // 2

    def plain(gain: float) -> BenchAt:
        return lambda _: with_creep(with_gain(case, gain), 0.0)

    special: dict[int, tuple[str, BenchAt]] = {
        2: (
            f"gain drops by 5 % before recording {half}",
            lambda k: with_creep(with_gain(case, gains[1] * (0.95 if k >= half else 1.0)), 0.0),
        ),
        4: (
            f"creep comes before recording {half}",
            lambda k: with_creep(with_gain(case, gains[3]), 1.0 if k >= half else 0.0),
        ),
        7: ("gain 12 % below the others from the start", plain(0.88)),
    }
    told = {}
    for number in range(1, benches + 1):
        name = f"bench_{number:02d}"
        words, at = special.get(number, ("", plain(gains[number - 1])))
        write_bench(folder / name, at, recordings, seconds, 1.0, rng)
        if words:
            told[name] = words
    damaged = folder / "bench_09" / f"work_{recordings - 1}.csv"
    if damaged.is_file():
        damaged.write_bytes(damaged.read_bytes()[:200] + b"\x00\xff\x00")
        told["bench_09"] = f"{damaged.name} is damaged"
    return told


def year(folder: Path, weeks: int, seconds: float, seed: int) -> dict[str, str]:
    """Write the archive of one bench over a year; return its truth."""
    case = bench_with_creep("plays", seed)
    case = replace(case, shows_temperature=True, truth={**case.truth, "cold": True})

    def at(week: int) -> Case:
        gain = (REPAIR_GAIN if week >= REPAIR_WEEK else 1.0) * (1.0 + GAIN_PER_K * COLD_K * (week == COLD_WEEK))
        grown = CREEP_PER_MONTH ** (week / WEEKS_PER_MONTH) if week else 0.0
        return with_creep(with_gain(case, gain), grown)

    write_bench(folder / "bench", at, weeks, seconds, 7.0, np.random.default_rng(seed))
    first, last = (at(week).effects["creep"].parameters["per_decade"] for week in (1, weeks))
    return {
        "creep": f"grows from {100 * first:.3g} to {100 * last:.3g} % per decade, 3 % a month",
        "repair": f"week {REPAIR_WEEK}: gain {100 * (REPAIR_GAIN - 1):+.3g} %",
        "cold": f"week {COLD_WEEK}: {COLD_K:g} K, gain {100 * GAIN_PER_K * COLD_K:+.3g} %",
        "noise": f"{case.noise.rms_N:.4g} N of {case.plant.law.full_N:.4g} N",
    }


def run_history(archive: Path, output: Path, options: tuple[str, ...] = ()) -> tuple[str, float]:
    """Run `piezod history`; return what it prints and its processor time with all its processes [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "piezod", "history", str(archive), "-o", str(output), *options]
    done = subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return done.stdout, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def _write(path: Path, case: Case, record: Record, date: datetime) -> None:
    write_record(path, case, record)
    path.write_text(f"# recorded: {date.isoformat()}\n{path.read_text(encoding='utf-8')}", encoding="utf-8")


def _identify(folder: Path) -> None:
    """Identify the model with the information of its recording, as `piezod identify` writes it."""
    name = "identification.csv"
    model = identified(Description(name, (), name, "voltage_V", "force_N"), folder)
    source = read_source(folder / name, "identification", ("voltage_V", "force_N"))
    provenance = model.provenance.model_copy(update={"created": FIRST_DAY.isoformat()})
    information = identified_information(model, [source])
    save_model(model.model_copy(update={"information": information, "provenance": provenance}), folder / "model.yaml")


def add_options(fleet_parser: argparse.ArgumentParser, year_parser: argparse.ArgumentParser) -> None:
    """Options of both studies."""
    for parser in (fleet_parser, year_parser):
        parser.add_argument("folder", type=Path, metavar="DIR", help="folder to write")
        parser.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of a recording, %(default)s")
        parser.add_argument("--seed", type=int, default=3, metavar="S", help="seed of the benches, %(default)s")
        parser.add_argument("--make-only", action="store_true", help="do not diagnose")
    fleet_parser.add_argument("--benches", type=int, default=10, metavar="N", help="number of benches, %(default)s")
    fleet_parser.add_argument("--recordings", type=int, default=20, metavar="N", help="of each bench, %(default)s")
    fleet_parser.set_defaults(run=_run_fleet)
    year_parser.add_argument("--weeks", type=int, default=52, metavar="N", help="number of recordings, %(default)s")
    year_parser.set_defaults(run=_run_year)


def _run_fleet(options: argparse.Namespace, _: argparse.ArgumentParser) -> None:
    archive = _emptied(options.folder)
    _finish(options, archive, fleet(archive, options.benches, options.recordings, options.seconds, options.seed))


def _run_year(options: argparse.Namespace, _: argparse.ArgumentParser) -> None:
    archive = _emptied(options.folder)
    _finish(options, archive, year(archive, options.weeks, options.seconds, options.seed))


def _emptied(folder: Path) -> Path:
    shutil.rmtree(folder / "archive", ignore_errors=True)
    return folder / "archive"


def _finish(options: argparse.Namespace, archive: Path, told: dict[str, str]) -> None:
    (options.folder / "truth.json").write_text(json.dumps(told, indent=1), encoding="utf-8")
    if not options.make_only:
        printed, cpu_s = run_history(archive, options.folder / "history")
        print(printed, end="")
        print(f"processor time {cpu_s:.0f} s")
    for name, words in told.items():
        print(f"truth: {name}: {words}")
