"""Scores the findings on a study against its sealed truth."""

from datetime import datetime
from pathlib import Path

from firmware_sim.concealed.errors import StudyError
from firmware_sim.concealed.scoring.case_score import CaseScore, HeldOut, score_case
from firmware_sim.concealed.scoring.verdicts import BASE, EXTENDED, read_simulation, read_verdict, sealed_at
from firmware_sim.concealed.study.seal import sealed_arrays, unpack_arrays
from firmware_sim.concealed.study.truth import TrueCase, read_truth


def score_study(directory: Path, verdicts: Path, *, partial: bool = False) -> list[CaseScore]:
    """Score every case of a study.

    Parameters
    ----------
    verdicts
        Directory with one folder per case.
    partial
        True: leave out cases without findings. False: refuse them.

    Raises
    ------
    StudyError
        The truth was changed, or findings are missing or older than the seal.
    """
    cases, sealed = read_truth(directory), sealed_at(directory)
    scores = []
    for case in cases:
        score = _score(directory, verdicts / case.name, case, sealed)
        if score is not None:
            scores.append(score)
        elif not partial:
            raise StudyError(
                f"{verdicts / case.name}: has no verdict; diagnose the case, or leave it out with --partial"
            )
    return scores


def _score(directory: Path, folder: Path, case: TrueCase, sealed: datetime) -> CaseScore | None:
    verdict = read_verdict(folder, sealed)
    if verdict is None:
        return None
    true_N = unpack_arrays(sealed_arrays(directory, case.name).read_bytes())["held_out_true_N"]
    base_N, extended_N = (read_simulation(folder / name, true_N.size) for name in (BASE, EXTENDED))
    return score_case(case, verdict, HeldOut(true_N, base_N, extended_N))
