"""Tasks on this machine, several in parallel."""

from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from piezod.tasks.isolated import IsolatedProcesses
from piezod.tasks.task import Outcome, TaskSource


def run_locally(source: TaskSource, jobs: int) -> Generator[Outcome, None, None]:
    """Run tasks and yield each outcome when it is complete.

    Closing the generator early kills the running processes.

    Parameters
    ----------
    jobs
        Number of parallel processes, at least 1.
    """
    processes = IsolatedProcesses()
    running: set[Future[Outcome]] = set()
    with ThreadPoolExecutor(jobs) as threads:
        try:
            while True:
                while len(running) < jobs and (task := source()) is not None:
                    if isinstance(task, Outcome):
                        yield task
                    else:
                        running.add(threads.submit(processes.run, task))
                if not running:
                    return
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                running -= done
                for future in done:
                    yield future.result()
        finally:  # also after an early close of the generator
            threads.shutdown(wait=False, cancel_futures=True)
            processes.end()
