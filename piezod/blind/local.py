"""Cases judged on this machine, as many beside each other as it has cores."""

import os
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from piezod.blind.case import read_case
from piezod.blind.isolated import Processes
from piezod.blind.verdict import Verdict, failed_verdict
from piezod.errors import PiezodError


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0))


def judge_here(folders: Sequence[Path], jobs: int) -> Generator[Verdict, None, None]:
    """Judge cases; the verdicts come as they are ready.

    Parameters
    ----------
    folders
        Of the cases.
    jobs
        Processes beside each other, at least 1.
    """
    processes = Processes()

    def judged(folder: Path) -> Verdict:
        try:
            case = read_case(folder)
        except PiezodError as error:
            return failed_verdict(folder.name, str(error))
        return processes.judge(case)

    with ThreadPoolExecutor(jobs) as threads:
        try:
            for done in as_completed([threads.submit(judged, folder) for folder in folders]):
                yield done.result()
        finally:  # also when nobody wants more: what runs is ended, what waits is not begun
            threads.shutdown(wait=False, cancel_futures=True)
            processes.end()
