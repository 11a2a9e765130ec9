"""Diagnosis of cases on this machine, several in parallel."""

from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from piezod.blind.case import read_case
from piezod.blind.isolated import IsolatedProcesses
from piezod.blind.verdict import Verdict, failed_verdict
from piezod.errors import PiezodError


def diagnose_locally(folders: Sequence[Path], jobs: int) -> Generator[Verdict, None, None]:
    """Diagnose cases and yield each verdict when it is complete.

    Closing the generator early kills the running processes.

    Parameters
    ----------
    jobs
        Number of parallel processes, at least 1.
    """
    processes = IsolatedProcesses()

    def diagnose(folder: Path) -> Verdict:
        try:
            case = read_case(folder)
        except PiezodError as error:
            return failed_verdict(folder.name, str(error))
        return processes.diagnose(case)

    with ThreadPoolExecutor(jobs) as threads:
        try:
            for done in as_completed([threads.submit(diagnose, folder) for folder in folders]):
                yield done.result()
        finally:  # also after an early close of the generator
            threads.shutdown(wait=False, cancel_futures=True)
            processes.end()
