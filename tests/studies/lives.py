"""Lives of concealed benches: identification, work, unchanged work, one change, unchanged work.

    python -m tests.studies lives --cases 5 --json lives.json

Every step diagnoses its own recording with the model that the step before has written. `firmware_sim` draws the bench
and its change; the truth is compared when the last step is done. With `--alone`, no older recording lies beside the
model.
"""

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from firmware_sim.concealed.study.catalogue import ENTRIES
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.lives import CHANGES, STEPS, Life, draw_life
from firmware_sim.concealed.study.make import write_record
from piezod.blind.case import Description
from piezod.blind.diagnose_case import identified
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.verdict.information import identified_information
from piezod.errors import PiezodError
from piezod.estimation.recordings.sources import read_source
from piezod.model import save_model
from tests.studies.contradictions import Result, contradictions

MODEL = "model.yaml"
CHANGED_STEP = 3
FLAGS = ("unexplained", "partly_explained")  # verdicts that report a remainder


@dataclass
class StepRow:
    """Verdict of one step beside the truth.

    Parameters
    ----------
    verdict
        Of the findings; "failed" with the error in `wrong`.
    named
        New or changed effects, `name:status`.
    right
        Whether these are exactly the true ones. An unchanged bench must match, or keep the remainder of the step
        before.
    again
        Effects of the given model that are reported as new.
    contradicted
        Sentences that simulation contradicts.
    inside
        For each changed parameter whether `from` and `to` lie inside their intervals.
    wrong
        What went wrong; empty: nothing.
    cpu_s
        Processor time [s].
    """

    verdict: str
    named: tuple[str, ...] = ()
    right: bool = False
    again: tuple[str, ...] = ()
    contradicted: tuple[str, ...] = ()
    inside: tuple[bool, ...] = ()
    wrong: str = ""
    cpu_s: float = 0.0


@dataclass
class LifeRow:
    """One life.

    Parameters
    ----------
    number, family, change, effect
        As drawn.
    hidden
        Effects of the first work.
    steps
        Its steps from the first work on.
    """

    number: int
    family: str
    change: str
    effect: str
    hidden: tuple[str, ...]
    steps: list[StepRow] = field(default_factory=list)

    def text(self) -> str:
        """The rows of the table."""
        head = f"{self.number:3} {self.family:<13}{' + '.join(self.hidden):<42} {self.change} {self.effect}"
        lines = [head.rstrip()]
        for number, step in enumerate(self.steps, 1):
            mark = "right" if step.right else "WRONG"
            lines.append(f"      {number} {mark} {step.verdict:<17}{step.cpu_s:6.1f} s  {', '.join(step.named) or '-'}")
            lines += [f"          {one}" for one in (*step.contradicted, step.wrong) if one]
        return "\n".join(lines)


def run(number: int, seed: int, *, alone: bool) -> LifeRow:
    """Draw, record and diagnose one life."""
    family = tuple(FAMILIES)[number % len(FAMILIES)]
    change = CHANGES[number % len(CHANGES)]
    life = draw_life(family, change, np.random.SeedSequence((seed, number)))
    row = LifeRow(number, family, change, life.effect, tuple(life.hidden))
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary)
        for step in life.steps:
            write_record(place / step.record.name, step.case, step.record)
        first = life.steps[0].record.name
        given = place / MODEL
        _save_identified(place, first, given)
        if alone:
            (place / first).unlink()
        for k in range(1, STEPS):
            output, recording = place / f"step_{k}", place / life.steps[k].record.name
            row.steps.append(_step(life, k, given, recording, output, row.steps))
            if alone:
                recording.unlink()
            if not (output / MODEL).is_file():
                break
            given = Path(shutil.copy(output / MODEL, place / f"given_{k}.yaml"))
    return row


def _save_identified(place: Path, first: str, given: Path) -> None:
    """Identify the model of the first recording, with the information of that recording."""
    model = identified(Description(first, (), first, "voltage_V", "force_N"), place)
    source = read_source(place / first, "identification", ("voltage_V", "force_N"))
    save_model(model.model_copy(update={"information": identified_information(model, [source])}), given)


def _step(life: Life, number: int, given: Path, recording: Path, output: Path, before: Sequence[StepRow]) -> StepRow:
    """Diagnose one recording; `before` are the earlier steps."""
    begun_s = time.process_time()
    try:
        diagnose_files([recording], given, output, None, None, lambda *_: None)
    except PiezodError as error:
        return StepRow("failed", wrong=str(error), cpu_s=time.process_time() - begun_s)
    cpu_s = time.process_time() - begun_s
    result = Result(given, output, (recording,))
    findings, contradicted = result.findings, tuple(contradictions(result))
    named = tuple(f"{one['name']}:{one.get('status', 'new')}" for one in findings["effects"])
    if findings.get("base", {}).get("status") == "changed":
        named = (*named, "base:changed")
    flagged = [verdict in FLAGS for verdict in (findings["verdict"], *(step.verdict for step in before[-1:]))]
    right = set(named) == _truth(life, number)
    if number > 1 and not named:
        right = right and (findings["verdict"] == "matches" or all(flagged))
    again = tuple(one.split()[0] for one in contradicted if "is reported as new" in one)
    return StepRow(
        findings["verdict"],
        named,
        right,
        again,
        contradicted,
        tuple(_inside(life, number, findings["effects"])),
        cpu_s=cpu_s,
    )


def _truth(life: Life, number: int) -> set[str]:
    """What a step should report beside what is kept, as `name:status`."""
    if number == 1:
        return {f"{name}:new" for name in life.hidden}
    if number != CHANGED_STEP:
        return set()
    status = {"grows": "changed", "shrinks": "changed", "gone": "gone", "new": "new"}.get(life.change)
    if status is not None:
        return {f"{life.effect}:{status}"}
    return set() if life.change == "none" else {"base:changed"}


def _inside(life: Life, number: int, effects: Sequence[dict[str, Any]]) -> list[bool]:
    """Whether `from` and `to` of the changed parameter lie inside their 95 % intervals."""
    if number != CHANGED_STEP or life.change not in {"grows", "shrinks"}:
        return []
    scale = ENTRIES[life.effect].scale
    found = next((one for one in effects if one["name"] == life.effect and one.get("status") == "changed"), None)
    if found is None or scale not in found["parameters"]:
        return []
    to = found["parameters"][scale]
    pairs = ((to.get("was"), life.hidden), (to, life.since))
    return [
        told is not None and told["low"] <= effects_[life.effect].parameters[scale] <= told["high"]
        for told, effects_ in pairs
    ]


def summary(rows: Sequence[LifeRow]) -> str:
    """Shares of right steps, effects named again, contradictions."""
    steps = [(number, row, step) for row in rows for number, step in enumerate(row.steps, 1)]
    groups = {
        "first work": [s for n, _, s in steps if n == 1],
        "unchanged": [s for n, row, s in steps if n in {2, 4} or (n == CHANGED_STEP and row.change == "none")],
        "changed": [s for n, row, s in steps if n == CHANGED_STEP and row.change != "none"],
    }
    lines = [f"{'':<12}{'steps':>6}{'right':>7}{'again new':>11}{'contradictions':>16}{'median s':>10}"]
    for name, mine in groups.items():
        if mine:
            counts = len(mine), sum(s.right for s in mine), sum(len(s.again) for s in mine)
            told = sum(len(s.contradicted) for s in mine)
            cpu_s = float(np.median([s.cpu_s for s in mine]))
            lines.append(f"{name:<12}{counts[0]:>6}{counts[1]:>7}{counts[2]:>11}{told:>16}{cpu_s:>10.1f}")
    inside = [one for _, _, step in steps for one in step.inside]
    lines.append(f"from and to inside their intervals: {sum(inside)} of {len(inside)}")
    return "\n".join(lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--cases", type=int, default=20, metavar="N", help="number of lives, %(default)s")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="number of the first life, %(default)s")
    parser.add_argument("--seed", type=int, metavar="S", help="seed of the lives; default: of the operating system")
    parser.add_argument("--alone", action="store_true", help="no older recording beside the model")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="number of parallel lives")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, _: argparse.ArgumentParser) -> None:
    seed = int(np.random.SeedSequence().generate_state(1)[0]) if options.seed is None else options.seed
    rows: list[LifeRow] = []
    print(f"seed {seed}", flush=True)
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        numbers = range(options.first, options.first + options.cases)
        for task in [pool.submit(run, number, seed, alone=options.alone) for number in numbers]:
            rows.append(task.result())
            print(rows[-1].text(), flush=True)
            if options.json:
                options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1), encoding="utf-8")
    print(summary(rows))
