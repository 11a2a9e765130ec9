"""Diagnosis of a case in a separate process with one thread; a crash affects this case only, and it is tried again."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

from piezod.blind.case import Case
from piezod.blind.verdict import Verdict, failed_verdict, read_verdict

ATTEMPTS = 3
"""Processes started for a case before it counts as failed; later crashes come from the case, not from the machine."""

LONGEST_S = 3600.0
"""Time limit of a process [s]; a case takes seconds to minutes."""

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


class IsolatedProcesses:
    """The running processes, one per case; `end` kills them all."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._ended = False

    def diagnose(self, case: Case) -> Verdict:
        """Diagnose a case; a process that dies is replaced, up to `ATTEMPTS` processes in total.

        The call blocks, so each parallel process needs a thread of its own.
        """
        begun_s = time.monotonic()
        problem = ""
        for _ in range(ATTEMPTS):
            with tempfile.TemporaryDirectory(prefix="piezod-blind-", ignore_cleanup_errors=True) as scratch:
                folder, output = Path(scratch, "case"), Path(scratch, case.name)
                folder.mkdir()
                case.unpack(folder)
                problem = self._run(folder, output)
                verdict = None if problem else read_verdict(case.name, output)
            if verdict is not None or self._ended:
                break
        elapsed_s = time.monotonic() - begun_s
        reason = f"its process {problem or 'wrote no verdict'}, {ATTEMPTS} times"
        return verdict or failed_verdict(case.name, reason, elapsed_s)

    def end(self) -> None:
        """Kill all processes and start no others."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.kill()

    def _run(self, folder: Path, output: Path) -> str:
        """Run one process to its end; return the problem in words, or an empty text."""
        errors = folder.parent / "stderr"
        command = [sys.executable, "-m", "piezod.blind.worker", str(folder), str(output)]
        with errors.open("wb") as stderr, self._lock:
            if self._ended:
                return "was ended"
            process = subprocess.Popen(  # noqa: S603  # our own interpreter and module
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                env=os.environ | ONE_THREAD,
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


def diagnose_isolated(case: Case) -> Verdict:
    """Diagnose a case in a separate process.

    An error of the diagnosis, or a process that dies, gives a failed verdict and no exception.

    Parameters
    ----------
    case
        Case with its recordings.
    """
    return IsolatedProcesses().diagnose(case)


def _exit_problem(code: int, errors: Path) -> str:
    """Exit code or signal in words, with the last line of stderr; an empty text for exit code 0."""
    if code == 0:
        return ""
    how = f"was ended by signal {-code}" if code < 0 else f"ended with {code}"
    lines = errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return how + (f" ({lines[-1]})" if lines else "")
