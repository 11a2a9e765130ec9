"""A case judged in a process of its own: one thread in it, nothing left behind, and a crash costs one attempt."""

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

ATTEMPTS = 3  # after that many deaths it is the case, not the machine
LONGEST_S = 3600.0  # a case takes seconds; what takes an hour never ends
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


class Processes:
    """Processes that judge cases, each its own; all of them can be ended at once."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.Lock()
        self._ended = False

    def judge(self, case: Case) -> Verdict:
        """Judge a case; a process that dies is started again, up to three times.

        Called from as many threads as there shall be processes.
        """
        begun_s = time.monotonic()
        why = ""
        for _ in range(ATTEMPTS):
            with tempfile.TemporaryDirectory(prefix="piezod-blind-", ignore_cleanup_errors=True) as scratch:
                given, verdict = Path(scratch, "case"), Path(scratch, case.name)
                given.mkdir()
                case.unpack(given)
                why = self._run(given, verdict)
                found = None if why else read_verdict(case.name, verdict)
            if found is not None or self._ended:
                break
        took_s = time.monotonic() - begun_s
        return found or failed_verdict(case.name, f"its process {why or 'said nothing'}, {ATTEMPTS} times", took_s)

    def end(self) -> None:
        """End all of them; none is started any more."""
        with self._lock:
            self._ended = True
            for process in self._running:
                process.kill()

    def _run(self, given: Path, verdict: Path) -> str:
        """Run one process to its end; what was wrong with that, in words, or nothing."""
        said = given.parent / "stderr"
        command = [sys.executable, "-m", "piezod.blind.worker", str(given), str(verdict)]
        with said.open("wb") as stderr, self._lock:
            if self._ended:
                return "was ended"
            process = subprocess.Popen(  # noqa: S603  # our own interpreter and module
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=stderr,
                env=os.environ | ONE_THREAD,
                start_new_session=True,  # Ctrl-C is for us to hear; we end them
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
        return _ending(code, said)


def judge_apart(case: Case) -> Verdict:
    """Judge a case in a process of its own."""
    return Processes().judge(case)


def _ending(code: int, said: Path) -> str:
    if code == 0:
        return ""
    how = f"was ended by signal {-code}" if code < 0 else f"ended with {code}"
    lines = said.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return how + (f" ({lines[-1]})" if lines else "")
