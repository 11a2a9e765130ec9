"""The next experiment on the cases of a concealed study that a diagnosis left with rivals.

python -m tests.studies rivals STUDY VERDICTS

The plants of an opened study are drawn again from its seed. For every verdict in which an effect has a rival, the next
experiment of at most a minute is computed from the same files, driven on the plant from rest, and both recordings are
diagnosed. The same is done with cases without a rival and with nulls, where nothing may get worse.
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

from firmware_sim.concealed.plant.drives import temperature
from firmware_sim.concealed.study.case import Case, Record
from firmware_sim.concealed.study.drawing import draw_case
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.make import write_record
from firmware_sim.concealed.study.plan import case_specs
from firmware_sim.concealed.study.seal import TRUTH, unpack
from firmware_sim.concealed.study.truth import TrueCase, read_truth
from piezod.blind.case import read_description
from piezod.blind.diagnose_case import MODEL, identified
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.experiment import next_experiment, separation
from piezod.diagnose.isolability import isolability
from piezod.diagnose.prepare import past_sources, read_source
from piezod.model import save_model

NEXT = "recording_next.csv"
FACTOR = 2.0
"""A reached separation within this factor of the predicted one keeps the promise."""


@dataclass(frozen=True)
class RivalsRow:
    """One case before and after its next experiment.

    Parameters
    ----------
    case, kind
        Name and kind of the case.
    truth
        True effects; a foreign effect in brackets.
    before, after
        Names given, each with its rivals.
    right_before, right_after
        Whether the names are exactly the true ones.
    open_before, open_after
        Pairs of an effect and its rival.
    predicted, reached
        Sizes from which on the pairs are separated, in noises.
    seconds
        Length of the drive [s].
    """

    case: str
    kind: str
    truth: tuple[str, ...]
    before: tuple[str, ...]
    after: tuple[str, ...]
    right_before: bool
    right_after: bool
    open_before: tuple[tuple[str, str], ...]
    open_after: tuple[tuple[str, str], ...]
    predicted: tuple[float, ...]
    reached: tuple[float, ...]
    seconds: float

    @property
    def settled(self) -> bool:
        """Whether none of the pairs is open any more, and the true one of each was kept."""
        return not set(self.open_before) & set(self.open_after) and (self.right_after or not self.right_before)

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self) | {"settled": self.settled}

    def text(self) -> str:
        """One line."""
        sizes = " ".join(f"{a:.2g}/{b:.2g}" for a, b in zip(self.predicted, self.reached, strict=True))
        said = f"{' + '.join(self.before) or '-'} => {' + '.join(self.after) or '-'}"
        marks = f"{'right' if self.right_before else 'wrong'} => {'right' if self.right_after else 'wrong'}"
        true = " + ".join(self.truth) or "-"
        return f"{self.case} {self.kind:<7} {true}: {said}; {marks}; {sizes}; {self.seconds:.0f} s"


def summary(rows: Sequence[RivalsRow]) -> str:
    """The summary lines."""
    rivals = [row for row in rows if row.open_before]
    others = [row for row in rows if not row.open_before]
    known = [row for row in rivals if row.kind != "foreign"]
    settled = sum(row.settled for row in known)
    right = sum(row.right_before for row in known), sum(row.right_after for row in known)
    pairs = [pair for row in rivals for pair in zip(row.predicted, row.reached, strict=True)]
    kept = sum(1.0 / FACTOR <= b / a <= FACTOR for a, b in pairs)
    worse = [row.case for row in others if row.right_before and not row.right_after]
    better = [row.case for row in others if not row.right_before and row.right_after]
    return (
        f"rivals open: {len(rivals)} cases, {len(known)} without a foreign effect; settled {settled} of {len(known)}; "
        f"exact names {right[0]} => {right[1]}; predicted separation within a factor {FACTOR:g}: {kept} of "
        f"{len(pairs)} pairs\nothers: {len(others)} cases; made worse: {', '.join(worse) or 'none'}; made right: "
        f"{', '.join(better) or 'none'}"
    )


def redrawn(study: Path) -> dict[str, Case]:
    """Draw the cases of an opened study again; ready to be driven, by name."""
    content = json.loads(unpack((study / TRUTH).read_bytes()))
    entropy, count = np.random.SeedSequence(int(content["entropy"])), len(content["cases"])
    plan, *children = entropy.spawn(count + 1)
    families = tuple(FAMILIES) if any(one.family for one in read_truth(study)) else ("",)
    specs = case_specs(np.random.Generator(np.random.PCG64(plan)), count, "all", None, None, families)
    return {
        f"case_{k:04d}": lambda spec=spec, child=child: draw_case(spec, child)
        for k, (spec, child) in enumerate(zip(specs, children, strict=True), 1)
    }


def run(study: Path, verdict: Path, truth: TrueCase, longest_s: float) -> RivalsRow | None:
    """Plan, drive and diagnose one case; None where no pair of effects is open in it."""
    case = redrawn(study)[truth.name]()
    findings = json.loads((verdict / "findings.json").read_text(encoding="utf-8"))
    before = {one["name"]: tuple(rival["name"] for rival in one["rivals"]) for one in findings["effects"]}
    pairs = _pairs(before)
    folder = study / truth.name
    description = read_description(folder)
    asked_paths = [folder / name for name in description.recordings]
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        model_path = place / MODEL
        (place / description.identification).symlink_to((folder / description.identification).resolve())
        save_model(identified(description, folder), model_path)
        model = identified(description, folder)
        channels = (model.input.channel, model.output.channel)
        asked = [read_source(path, "recording", channels) for path in asked_paths]
        past, _ = past_sources(model, place, asked)
        known = isolability(model, asked, past)
        planned = next_experiment(model, asked, past, known, longest_s, pairs or None)
        if planned is None:
            return None
        first = next(record for record in case.records if record.name.startswith("recording"))
        seed = int(np.random.SeedSequence(first.seed).generate_state(1)[0])
        rate_Hz = first.drive.rate_Hz
        warmth = temperature(np.random.default_rng(seed), planned.voltage_V.size / rate_Hz + 1.0, rate_Hz)
        drive = replace(
            first.drive,
            voltage_V=np.round(planned.voltage_V, 4),
            temperature_C=warmth[: planned.voltage_V.size],
        )
        write_record(place / NEXT, case, Record(NEXT, drive, seed))
        diagnosis = diagnose_files([*asked_paths, place / NEXT], model_path, place / "out", None, None, lambda *_: None)
        both = [*asked, read_source(place / NEXT, "recording", channels)]
        reached = isolability(model, both, past)
    after = {one.name: tuple(rival.name for rival in one.rivals) for one in diagnosis.findings.effects}
    true = set(truth.names)
    return RivalsRow(
        truth.name,
        truth.kind,
        (*sorted(true), *((f"({truth.foreign})",) if truth.foreign else ())),
        tuple(_said(before)),
        tuple(_said(after)),
        set(before) == true,
        set(after) == true,
        pairs,
        _pairs(after),
        planned.sizes,
        tuple(separation(reached, pair.first, pair.second) for pair in planned.pairs),
        planned.voltage_V.size * planned.dt_s,
    )


def _pairs(named: dict[str, tuple[str, ...]]) -> tuple[tuple[str, str], ...]:
    return tuple((name, rival) for name, rivals in named.items() for rival in rivals)


def _said(named: dict[str, tuple[str, ...]]) -> Iterator[str]:
    for name, rivals in named.items():
        yield f"{name} (or {', '.join(rivals)})" if rivals else name


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("study", type=Path, metavar="STUDY", help="opened study")
    parser.add_argument("verdicts", type=Path, metavar="VERDICTS", help="its verdicts")
    parser.add_argument("--most", type=int, default=40, metavar="N", help="cases with rivals, %(default)s")
    parser.add_argument("--others", type=int, default=20, metavar="N", help="cases without, %(default)s")
    parser.add_argument("--longest-s", type=float, default=60.0, metavar="T", help="longest drive, %(default)s s")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="number of parallel cases")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    truths = {one.name: one for one in read_truth(options.study)}
    rivals, others = [], []
    for verdict in sorted(options.verdicts.glob("case_*")):
        file = verdict / "findings.json"
        if not file.exists():
            continue
        effects = json.loads(file.read_text(encoding="utf-8"))["effects"]
        (rivals if any(one["rivals"] for one in effects) else others).append(verdict)
    chosen = [*rivals[: options.most], *others[: options.others]]
    if not chosen:
        parser.error(f"{options.verdicts}: has no verdicts")
    begun_s, rows = time.monotonic(), []
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        tasks = [pool.submit(run, options.study, one, truths[one.name], options.longest_s) for one in chosen]
        for task in tasks:
            if (row := task.result()) is not None:
                rows.append(row)
                print(row.text(), flush=True)
    print(f"{summary(rows)}\n{time.monotonic() - begun_s:.0f} s")
    if options.json:
        options.json.write_text(json.dumps([row.as_dict() for row in rows], indent=1), encoding="utf-8")
