"""Scores the verdicts on a study against its sealed truth."""

from datetime import datetime
from pathlib import Path

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.scoring.judge import HeldOut, Judgement, judge
from firmware_sim.concealed.scoring.verdicts import BASE, EXTENDED, read_simulation, read_verdict, sealed_at
from firmware_sim.concealed.study.seal import sealed_arrays, unpack_arrays
from firmware_sim.concealed.study.truth import TrueCase, read_truth


def score(directory: Path, verdicts: Path, *, partial: bool = False) -> list[Judgement]:
    """Judge every case of a study.

    Parameters
    ----------
    directory
        The study.
    verdicts
        Has a folder for every case.
    partial
        Leave out cases without a verdict, which otherwise are refused.

    Raises
    ------
    StudyError
        The truth is not the one that was sealed, a verdict is older than the seal, or is missing.
    """
    cases, sealed = read_truth(directory), sealed_at(directory)
    judged = []
    for case in cases:
        found = _judged(directory, verdicts / case.name, case, sealed)
        if found is not None:
            judged.append(found)
        elif not partial:
            raise StudyError(f"{verdicts / case.name}: has no verdict; run it, or score what is there with --partial")
    return judged


def _judged(directory: Path, folder: Path, case: TrueCase, sealed: datetime) -> Judgement | None:
    verdict = read_verdict(folder, sealed)
    if verdict is None:
        return None
    true_N = unpack_arrays(sealed_arrays(directory, case.name).read_bytes())["held_out_true_N"]
    base_N, extended_N = (read_simulation(folder / name, true_N.size) for name in (BASE, EXTENDED))
    return judge(case, verdict, HeldOut(true_N, base_N, extended_N))
