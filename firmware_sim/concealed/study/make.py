"""Makes a study: draws its cases, writes the recordings, and seals the truth."""

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from functools import partial
from itertools import repeat
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.study.case import Case, Record
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.plan import case_specs
from firmware_sim.concealed.study.seal import SEAL, TRUTH, pack, pack_arrays, sealed_arrays, write_seal

SCHEMA = "firmware_sim.concealed.truth/1"
CASE_SCHEMA = "firmware_sim.concealed.case/1"
ROWS = 2**14

Progress = Callable[[int, int], None]
"""Called with the number of finished cases and of all cases."""


def make(
    directory: Path,
    cases: int,
    *,
    seed: int | None = None,
    kind: str = "all",
    effect: str | None = None,
    strength: float | None = None,
    families: Sequence[str] = ("",),
    amid_s: float = 0.0,
    varied: bool = False,
    jobs: int = 1,
    progress: Progress | None = None,
) -> None:
    """Make a study in a directory without a study.

    Parameters
    ----------
    directory
        Directory of the study; created if missing.
    seed
        Seed of the study; None draws one from the operating system.
    kind, effect, strength, families
        See `plan.case_specs`.
    amid_s
        Time that is missing at the begin of the recordings of work of every third case [s]; they then begin somewhere
        in the range, with an unknown past.
    varied
        Whether the benches are varied (`bench.draw_varied_bench`).

    Raises
    ------
    StudyError
        The directory has a study already.
    """
    entropy = np.random.SeedSequence(seed)
    plan, *children = entropy.spawn(cases + 1)
    rng = np.random.Generator(np.random.PCG64(plan))
    planned = case_specs(rng, cases, kind, effect, strength, families, varied=varied)
    begins_s = [amid_s if k % 3 == 0 else 0.0 for k in range(1, cases + 1)]
    write_study(directory, "cases", SCHEMA, entropy, make_case, (planned, children, begins_s), jobs, progress)


def write_study(
    directory: Path,
    kind: str,
    schema: str,
    entropy: np.random.SeedSequence,
    make_one: Callable[..., dict[str, object]],
    arguments: Sequence[Sequence[Any]],
    jobs: int,
    progress: Progress | None,
) -> None:
    """Make every case, one after the other or in `jobs` processes, and seal the study.

    Parameters
    ----------
    kind
        Word for the cases in the truth and in the seal.
    make_one
        Writes a case and returns its truth. Its first arguments are the directory and the name of the case.
    arguments
        Its further arguments; each is a sequence with a member for every case.

    Raises
    ------
    StudyError
        The directory has a study already.
    """
    if (directory / SEAL).exists():
        raise StudyError(f"{directory}: has a study already; take another directory")
    (directory / "sealed").mkdir(parents=True, exist_ok=True)
    names = [f"case_{k:04d}" for k in range(1, len(arguments[0]) + 1)]
    truths = {}
    with ExitStack() as stack:
        pool = stack.enter_context(ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))) if jobs > 1 else None
        made = (map if pool is None else pool.map)(partial(make_one, directory), names, *arguments)
        for name, truth in zip(names, made, strict=True):
            truths[name] = truth
            if progress:
                progress(len(truths), len(names))
    text = json.dumps({"schema": schema, "entropy": str(entropy.entropy), kind: truths})
    (directory / TRUTH).write_bytes(pack(text.encode()))
    files = [directory / TRUTH, *(sealed_arrays(directory, name) for name in names)]
    write_seal(directory, files, **{kind: len(names)})


def make_case(
    directory: Path, name: str, spec: CaseSpec, seed: np.random.SeedSequence, begin_s: float
) -> dict[str, object]:
    """Draw and write one case; return its truth.

    Parameters
    ----------
    directory
        Folder of the study.
    name
        Name of the case and of its folder.
    spec
        Kind of the case and names of its effects.
    begin_s
        Time of the first sample that is written of its recordings of work [s]; 0: at rest.

    Raises
    ------
    StudyError
        No attempt gave a plausible case.
    """
    case = draw_case(spec, seed)
    folder = directory / name
    folder.mkdir(exist_ok=True)
    for record in case.records:
        is_work = record.name.startswith("recording")
        write_record(folder / record.name, case, record, max(record.begin_s, begin_s if is_work else 0.0))
    described = json.dumps(_description(case, begin_s), indent=1) + "\n"
    (folder / "case.json").write_text(described, encoding="utf-8")
    held_out = case.records[-1]
    sealed_arrays(directory, name).write_bytes(pack_arrays({"held_out_true_N": case.repeatable_N(held_out)}))
    return {**case.truth, "begin_s": begin_s}


def _description(case: Case, begin_s: float) -> dict[str, object]:
    """Content of `case.json`: what the diagnosis may know."""
    names = [record.name for record in case.records]
    at_rest = "every record starts at rest, depoled, at 0 V"
    amid = "recordings start somewhere in the range; the other records start at rest, depoled, at 0 V"
    if any(record.begin_s for record in case.records):
        unknown = [record.name for record in case.records if record.begin_s or (begin_s and record.name in names[1:-1])]
        amid = f"{', '.join(unknown)}: somewhere in the range; other records start at rest, depoled, at 0 V"
    return {
        "schema": CASE_SCHEMA,
        "identification": names[0],
        "recordings": names[1:-1],
        "held_out": names[-1],
        "input": "voltage_V",
        "output": "force_N",
        "start": amid if begin_s or any(record.begin_s for record in case.records) else at_rest,
    }


def write_record(path: Path, case: Case, record: Record, begin_s: float = 0.0) -> None:
    """Write the readings of a record of a case.

    Parameters
    ----------
    record
        One of its records, or one with another drive.
    begin_s
        Time of the first sample that is written [s].
    """
    columns = {
        "time_s": (record.drive.time_s, "%.6f"),
        "voltage_V": (case.recorded_voltage_V(record), "%.4f"),
        "force_N": (case.reading_N(record), "%.7g"),
    }
    if case.shows_temperature:
        columns["temperature_C"] = (case.temperature_C(record), "%.3f")
    row = ",".join(form for _, form in columns.values()) + "\n"
    table = np.column_stack([values for values, _ in columns.values()])[record.drive.time_s >= begin_s]
    with path.open("w", encoding="utf-8") as file:
        file.write(",".join(columns) + "\n")
        for start in range(0, len(table), ROWS):
            block = table[start : start + ROWS]
            file.write("".join(repeat(row, len(block))) % tuple(block.ravel().tolist()))
