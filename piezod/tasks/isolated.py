"""Tasks in separate processes with one thread each; a crash affects one task only, which is tried again."""

import os
import subprocess
import tempfile
import threading
from collections.abc import Generator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from pathlib import Path

from piezod.runtime.interpreter import python
from piezod.tasks.task import Outcome, Task, TaskSource, failed_outcome, read_outcome

ATTEMPTS = 3
"""Processes started for a task before it counts as failed; later crashes come from the task, not from the machine."""

LONGEST_S = 3600.0  # time limit of a process [s]; a task takes seconds to minutes
SINGLE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


class IsolatedProcesses:
    """The running processes, one per task; `end` kills them all."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._ended = False

    def run(self, task: Task) -> Outcome:
        """Run a task; a process that dies is replaced, up to `ATTEMPTS` processes in total.

        The call blocks, so each parallel process needs a thread of its own.
        """
        problem = ""
        for _ in range(ATTEMPTS):
            with tempfile.TemporaryDirectory(prefix="piezod-task-", ignore_cleanup_errors=True) as scratch:
                folder, output = Path(scratch, "task"), Path(scratch, "outcome", task.name)
                folder.mkdir()
                output.parent.mkdir()
                task.unpack(folder)
                problem = self._process(task.module, folder, output)
                outcome = None if problem else read_outcome(task.name, output)
            if outcome is not None or self._ended:
                break
        return outcome or failed_outcome(task.name, f"its process {problem or 'wrote no outcome'}, {ATTEMPTS} times")

    def end(self) -> None:
        """Kill all processes and start no others."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.kill()

    def _process(self, module: str, folder: Path, output: Path) -> str:
        """Run one process to its end; return the problem in words, or an empty text."""
        errors = folder.parent / "stderr"
        command = python("-m", module, str(folder), str(output))
        with errors.open("wb") as stderr, self._lock:
            if self._ended:
                return "was ended"
            process = subprocess.Popen(  # noqa: S603  # our own interpreter and modules
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                env=os.environ | SINGLE_THREAD,
                start_new_session=True,  # Ctrl-C reaches this process only, which ends the others
            )
            self._running.add(process)
        try:
            code = process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return f"took more than {LONGEST_S:g} s"
        finally:
            with self._lock:
                self._running.discard(process)
            if process.stdin:
                with suppress(BrokenPipeError):
                    process.stdin.close()
        return _exit_problem(code, errors)


def run_isolated(task: Task) -> Outcome:
    """Run a task in a separate process; a process that dies gives a failed outcome and no exception."""
    return IsolatedProcesses().run(task)


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


def _exit_problem(code: int, errors: Path) -> str:
    """Exit code or signal in words, with the last line of stderr; an empty text for exit code 0."""
    if code == 0:
        return ""
    how = f"was ended by signal {-code}" if code < 0 else f"ended with {code}"
    lines = errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return how + (f" ({lines[-1]})" if lines else "")
