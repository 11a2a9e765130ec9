"""`piezod blind run`: diagnoses every case of a study that has no verdict yet, and saves the verdicts."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from piezod.blind.case import case_folders, read_case
from piezod.blind.verdict import Verdict, VerdictFolder, as_verdict
from piezod.errors import PiezodError
from piezod.tasks.cluster import run_tasks
from piezod.tasks.task import Outcome, Task, failed_outcome

OnVerdict = Callable[[Verdict | None, int, int], None]


@dataclass(frozen=True)
class Run:
    """Number of cases after a run.

    Parameters
    ----------
    diagnosed, failed, already
        Cases that this run diagnosed, that failed in it, and that had a verdict before.
    """

    diagnosed: int
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
    """Diagnose the cases of a study without the sealed truth.

    Parameters
    ----------
    folder
        Folder for the verdicts. Cases with a verdict in it are skipped, so a second run continues an interrupted one.
    jobs
        Number of processes on this machine, at least 1; None: one per core.
    scheduler
        Address of a Dask scheduler whose workers diagnose the cases; None: this machine.
    only
        Names of the cases to diagnose; empty: all.
    on_verdict
        Called with (verdict, cases done, cases to do), first with None before the first verdict.

    Raises
    ------
    ConfigurationError
        The folder holds no finished study, or the verdicts cannot be written.
    UsageError
        A name in `only` is not the name of a case, or the folder holds verdicts on another study.
    UnreachableError
        The scheduler does not answer.
    """
    folders = case_folders(study, only)
    saved = VerdictFolder(folder, study)
    todo = [case for case in folders if not saved.has(case.name)]
    failed = 0
    if todo:
        on_verdict(None, 0, len(todo))
    remaining = iter(todo)

    def next_case() -> Task | Outcome | None:
        case = next(remaining, None)
        if case is None:
            return None
        try:
            return read_case(case)
        except PiezodError as error:
            return failed_outcome(case.name, str(error))

    with run_tasks(next_case, jobs, scheduler) as outcomes:
        for done, outcome in enumerate(outcomes, 1):
            verdict = as_verdict(outcome)
            saved.save(verdict)
            failed += verdict.failed is not None
            on_verdict(verdict, done, len(todo))
    return Run(len(todo) - failed, failed, len(folders) - len(todo))
