"""`piezod blind run`: every case of a study that has no verdict yet is judged, and what was said is kept."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from piezod.blind.case import case_folders
from piezod.blind.cluster import judge_there
from piezod.blind.local import cores, judge_here
from piezod.blind.verdict import Verdict, Verdicts

OnVerdict = Callable[[Verdict | None, int, int], None]


@dataclass(frozen=True)
class Run:
    """What came of a run.

    Parameters
    ----------
    judged, failed, already
        Cases: with a verdict of this run, without one, and with one from before.
    """

    judged: int
    failed: int
    already: int


def run_study(
    study: Path,
    folder: Path,
    *,
    jobs: int | None,
    scheduler: str | None,
    only: tuple[str, ...],
    on_verdict: OnVerdict,
) -> Run:
    """Judge the cases of a study. The sealed truth is not opened.

    Parameters
    ----------
    study
        Its directory.
    folder
        Where the verdicts go; cases that have one there are left out, so a run that was stopped goes on.
    jobs
        Processes on this machine, at least 1; None: as many as it has cores.
    scheduler
        Address of a Dask scheduler, whose workers judge instead; None: this machine.
    only
        Names of the cases wanted; none: all.
    on_verdict
        Called with each verdict, how many are done and how many there are to do; with None before the first.

    Raises
    ------
    ConfigurationError
        There is no study, or the verdicts cannot be written.
    UsageError
        A case is not in the study, or the verdicts there are on another one.
    UnreachableError
        The scheduler does not answer.
    """
    folders = case_folders(study, only)
    verdicts = Verdicts(folder, study)
    left = [one for one in folders if not verdicts.has(one.name)]
    failed = 0
    if left:
        on_verdict(None, 0, len(left))
    ready = judge_here(left, jobs or cores()) if scheduler is None else judge_there(left, scheduler)
    with closing(ready):
        for done, verdict in enumerate(ready, 1):
            verdicts.keep(verdict)
            failed += verdict.failed is not None
            on_verdict(verdict, done, len(left))
    return Run(len(left) - failed, failed, len(folders) - len(left))
