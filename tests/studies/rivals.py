"""The next experiment after a first recording that leaves rivals, on concealed plants of four families.

    python -m tests.studies rivals --cases 80 --json rivals.json

Each case is a concealed plant with one hidden effect, or with none. A model is identified on its identification record.
The first recording is poor: two slow triangles, as a user might record at first. It is diagnosed. Rivals are listed
where the findings name one beside an effect. A pair is open where an effect found is smaller than what separates it
from its rival. The next experiment of at most a minute is computed from these files, driven on the plant from rest, and
both recordings are diagnosed. Where no pair is open, the experiment for what the recording cannot separate is driven,
and nothing may get worse.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from firmware_sim.concealed.plant.drives import Drive, temperature
from firmware_sim.concealed.study.case import Case, Record
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.make import write_record
from piezod.blind.case import Description
from piezod.blind.diagnose_case import MODEL, identified
from piezod.commissioning.investigate import open_pairs
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.experiment.isolability import isolability
from piezod.diagnose.experiment.planning import next_experiment, separation
from piezod.diagnose.judgement import Diagnosis
from piezod.estimation.recordings.sources import past_sources, read_source
from piezod.model import save_model

Pairs = tuple[tuple[str, str], ...]
HIDDEN = (
    "electrical_lag",
    "transport_delay",
    "sensor_filter",
    "feedthrough",
    "resonance",
    "creep",
    "charge_leakage",
    "gain_drift",
    "output_nonlinearity",
    "friction",
    "noncongruent_minor_loops",
    "rate_dependent_hysteresis",
    "contact_gap",
    "slew_limit",
    "voltage_clamp",
    "",
)
STRENGTHS = (4.0, 20.0)
FIRST_S = 20.0
FIRST_HZ = 0.1
FIRST, NEXT = "recording.csv", "recording_2.csv"
IDENTIFICATION = "identification.csv"
FACTOR = 2.0
"""A separation that is reached within this factor of the predicted one keeps the promise."""


@dataclass(frozen=True)
class RivalsRow:
    """One case before and after its next experiment.

    Parameters
    ----------
    case, family, truth
        Number, family and hidden effect; empty: none.
    before, after
        Names given, each with its rivals.
    right_before, right_after
        Whether the names are exactly the true ones.
    open_before, open_after
        Open pairs of an effect and its rival.
    predicted, reached
        Sizes from which on the pairs are separated, in noises.
    drive_s
        Length of the drive [s].
    """

    case: int
    family: str
    truth: str
    before: tuple[str, ...]
    after: tuple[str, ...]
    right_before: bool
    right_after: bool
    open_before: Pairs
    open_after: Pairs
    predicted: tuple[float, ...]
    reached: tuple[float, ...]
    drive_s: float

    @property
    def listed(self) -> int:
        """Rivals that the findings list before."""
        return _listed(self.before)

    @property
    def settled(self) -> bool:
        """Whether the names are right and no pair is open any more."""
        return self.right_after and not self.open_after

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self) | {"settled": self.settled}

    def text(self) -> str:
        """One line."""
        said = f"{' + '.join(self.before) or '-'} => {' + '.join(self.after) or '-'}"
        marks = " => ".join("right" if right else "wrong" for right in (self.right_before, self.right_after))
        shown = [f"{a} or {b}" for a, b in self.open_before], [f"{a} or {b}" for a, b in self.open_after]
        opened = " => ".join(", ".join(one) or "-" for one in shown)
        case = f"{self.case:3} {self.family:<12} {self.truth or '-'}"
        return f"{case}: {said}; {marks}; open {opened}; {self.drive_s:.0f} s"


def summary(rows: Sequence[RivalsRow]) -> str:
    """The summary lines, and the separations predicted beside those reached."""
    groups = {
        "with rivals listed": [row for row in rows if row.listed],
        "with an open pair": [row for row in rows if row.open_before],
        "named nothing, something hidden": [row for row in rows if not row.before and row.truth],
        "nothing hidden": [row for row in rows if not row.truth],
        "all": list(rows),
    }
    lines = [f"{'':<32}{'cases':>6}{'right before':>14}{'after':>7}{'settled':>9}{'made worse':>12}"]
    for name, mine in groups.items():
        counts = (
            sum(row.right_before for row in mine),
            sum(row.right_after for row in mine),
            sum(row.settled for row in mine),
            sum(row.right_before and not row.right_after for row in mine),
        )
        lines.append("{:<32}{:>6}{:>14}{:>7}{:>9}{:>12}".format(name, len(mine), *counts))
    listed = sum(row.listed for row in rows), sum(_listed(row.after) for row in rows if row.listed)
    lines.append(f"rivals listed in these cases: {listed[0]} before, {listed[1]} after")
    pairs = [pair for row in rows for pair in zip(row.predicted, row.reached, strict=True)]
    ratios = np.array([reached / predicted for predicted, reached in pairs])
    kept = np.mean((ratios <= FACTOR) & (ratios >= 1.0 / FACTOR)) if pairs else 0.0
    low, middle, high = np.percentile(ratios, (10, 50, 90)) if pairs else (0.0, 0.0, 0.0)
    lines.append(
        f"separation reached / predicted, {len(pairs)} pairs: median {middle:.2f} (tenth to ninetieth percentile "
        f"{low:.2f} to {high:.2f}); within a factor {FACTOR:g}: {100.0 * kept:.0f} %"
    )
    return "\n".join(lines)


def _listed(named: Sequence[str]) -> int:
    return sum(one.count(",") + 1 for one in named if "(" in one)


def run(number: int, seed: int, longest_s: float) -> RivalsRow | None:
    """Draw, record, diagnose, plan, record, diagnose; None where no experiment is worth while."""
    hidden = HIDDEN[number % len(HIDDEN)]
    family = tuple(FAMILIES)[number // len(HIDDEN) % len(FAMILIES)]
    strength = STRENGTHS[number // 2 % len(STRENGTHS)]
    names = (hidden,) if hidden else ()
    spec = CaseSpec("single" if hidden else "null", names, (strength,) * len(names), "white", family)
    case = draw_case(spec, np.random.SeedSequence((seed, number)))
    work = next(record for record in case.records if record.name.startswith("recording"))
    reach_V, rate_Hz = float(work.drive.voltage_V.max()), work.drive.rate_Hz
    slew = float(np.abs(np.diff(work.drive.voltage_V)).max()) * rate_Hz  # of the bench, as its mixed work shows
    phase = FIRST_HZ * np.arange(round(FIRST_S * rate_Hz)) / rate_Hz
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        write_record(place / IDENTIFICATION, case, case.records[0])
        description = Description(IDENTIFICATION, (FIRST,), IDENTIFICATION, "voltage_V", "force_N")
        model = identified(description, place)
        model_path, channels = place / MODEL, (model.input.channel, model.output.channel)
        save_model(model, model_path)
        _write(place / FIRST, case, work, reach_V * (1.0 - np.abs(2.0 * (phase % 1.0) - 1.0)), 1)
        before = _diagnosed([place / FIRST], model_path, place / "before")
        asked = [read_source(place / FIRST, "recording", channels)]
        past, _ = past_sources(model, place, asked)
        fitted = before.fitted()
        known = isolability(model, asked, past, fitted)
        pairs = open_pairs(before.findings, known)
        planned = next_experiment(model, asked, past, known, longest_s, pairs or None, fitted, slew)
        if planned is None:
            return None
        _write(place / NEXT, case, work, planned.voltage_V, 2)
        after = _diagnosed([place / FIRST, place / NEXT], model_path, place / "after")
        both = [*asked, read_source(place / NEXT, "recording", channels)]
        reached = isolability(model, both, past, fitted, {name for pair in pairs for name in pair} or None)
        named = after.fitted()
        open_after = open_pairs(after.findings, isolability(model, both, past, named, named)) if named else ()
    return RivalsRow(
        number,
        family,
        hidden,
        tuple(_said(before)),
        tuple(_said(after)),
        {one.name for one in before.findings.effects} == set(names),
        {one.name for one in after.findings.effects} == set(names),
        pairs,
        open_after,
        planned.sizes,
        tuple(separation(reached, pair.first, pair.second) for pair in planned.pairs),
        planned.voltage_V.size * planned.dt_s,
    )


def _write(path: Path, case: Case, work: Record, voltage_V: np.ndarray, number: int) -> None:
    """Drive the plant of a case from rest and write the record."""
    rate_Hz, seed = work.drive.rate_Hz, work.seed + 1000 * number
    warmth = temperature(np.random.default_rng(seed), voltage_V.size / rate_Hz + 1.0, rate_Hz)[: voltage_V.size]
    drive: Drive = replace(work.drive, voltage_V=np.round(voltage_V, 4), temperature_C=warmth)
    write_record(path, case, Record(path.name, drive, seed))


def _diagnosed(files: Sequence[Path], model: Path, output: Path) -> Diagnosis:
    return diagnose_files(files, model, output, None, None, lambda *_: None)


def _said(diagnosis: Diagnosis) -> Iterator[str]:
    for one in diagnosis.findings.effects:
        rivals = ", ".join(rival.name for rival in one.rivals)
        yield f"{one.name} ({rivals})" if rivals else one.name


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--cases", type=int, default=64, metavar="N", help="number of cases, %(default)s")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first case, %(default)s")
    parser.add_argument("--seed", type=int, metavar="S", help="seed of the cases; default: of the operating system")
    parser.add_argument("--longest-s", type=float, default=60.0, metavar="T", help="longest drive, %(default)s s")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="number of parallel cases")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, _: argparse.ArgumentParser) -> None:
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if options.seed is None else options.seed
    begun_s, rows = time.monotonic(), []
    print(f"seed {seed}", flush=True)
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        numbers = range(options.first, options.first + options.cases)
        for task in [pool.submit(run, number, seed, options.longest_s) for number in numbers]:
            if (row := task.result()) is not None:
                rows.append(row)
                print(row.text(), flush=True)
                if options.json:
                    options.json.write_text(json.dumps([row.as_dict() for row in rows], indent=1), encoding="utf-8")
    print(f"{summary(rows)}\n{time.monotonic() - begun_s:.0f} s")
