"""The parent of a worker: it counts, keeps what failed, ends a case that hangs, and begins again after a crash."""

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.board import Board
from tests.fuzz.target import Target

ROOT = Path(__file__).parents[2]
HANGS_AFTER_S = 10.0  # of computing; a case takes milliseconds
ASLEEP = 30  # times as long may pass by the clock: a machine that is busy or stands still is given its time
START_S = 600.0
MOST_RESTARTS = MOST_FINDINGS = 20
LOOK_EVERY_S = 0.05


@dataclass(frozen=True)
class Finding:
    """An input that broke a promise: what happened, and where the input is kept."""

    target: str
    what: str
    path: Path

    def text(self) -> str:
        """For people, with the command that repeats it."""
        said = self.what.splitlines()
        where = next((line.strip() for line in reversed(said) if line.strip().startswith("File ")), "")
        return (
            f"{self.target}: {said[-1][:300]} {where}\n    python -m tests.fuzz --reproduce {self.target} {self.path}"
        )


@dataclass
class Result:
    """What a run of one target came to."""

    target: str
    engine: str
    cases: int = 0
    accepted: int = 0
    findings: list[Finding] = field(default_factory=list)
    crashes: int = 0
    hangs: int = 0
    took_s: float = 0.0
    peak_MiB: float = 0.0
    grown_MiB: float = 0.0
    descriptors: int = 0


class Watch:
    """Runs one target.

    Parameters
    ----------
    module, target
        What is tried, and the module that a worker finds it in.
    engine
        `mutation` or `atheris`.
    keep
        Folder for the inputs that fail.
    """

    def __init__(
        self,
        module: str,
        target: str,
        engine: str,
        keep: Path,
        *,
        hangs_after_s: float = HANGS_AFTER_S,
        most_findings: int = MOST_FINDINGS,
    ) -> None:
        self._module, self._target, self._keep = module, target, keep
        self._hangs_after_s, self._most_findings = hangs_after_s, most_findings
        self.result = Result(target, engine)

    def run(self, seed: int, count: int, on_progress: Callable[[int], None] = lambda _cases: None) -> Result:
        """Try so many cases, with as many workers after each other as it takes."""
        begun_s, result = time.monotonic(), self.result
        for again in range(MOST_RESTARTS):
            left = count - result.cases
            if left <= 0 or len(result.findings) >= self._most_findings:
                break
            with tempfile.TemporaryDirectory(prefix="piezod-fuzz-") as name:
                ended = self._one_worker(Path(name), seed + 1_000_003 * again, left, on_progress)
            if ended and result.engine == "atheris":
                break
        result.took_s = time.monotonic() - begun_s
        return result

    def _one_worker(self, folder: Path, seed: int, count: int, on_progress: Callable[[int], None]) -> bool:
        """Watch one worker to its end; whether it came to its end by itself."""
        board, before = Board(folder / "board"), self.result.cases
        board.idle()
        command = [
            sys.executable,
            "-m",
            "tests.fuzz.worker",
            self._module,
            self._target,
            "--engine",
            self.result.engine,
        ]
        command += ["--seed", str(seed), "--count", str(count), "--folder", str(folder)]
        command += ["--most-findings", str(self._most_findings)]
        with (folder / "said").open("w+b") as said, (folder / "errors").open("w+b") as errors:
            process = subprocess.Popen(command, cwd=ROOT, stdout=said, stderr=errors, start_new_session=True)
            try:
                hung = self._wait(process, board, lambda: on_progress(before + board.cases))
            finally:
                if process.poll() is None:
                    process.kill()
                code = process.wait()
            self._take(before, board)
            self._hear(said)
            if hung or code != 0:
                self._blame(board, hung, code, _tail(errors))
        board.close()
        return not hung and code == 0

    def _wait(self, process: subprocess.Popen[bytes], board: Board, progress: Callable[[], None]) -> bool:
        """Wait for the worker's end, or for a case that does not end: then True."""
        begun_s, case, computed_s = time.monotonic(), 0, 0.0
        while process.poll() is None:
            if board.cases != case:
                case, computed_s = board.cases, computing_s(process.pid)
            late_s = time.monotonic() - begun_s if case == 0 else 0.0
            hung = board.age_s > self._hangs_after_s and computing_s(process.pid) - computed_s > self._hangs_after_s
            if hung or board.age_s > ASLEEP * self._hangs_after_s or late_s > START_S:
                return True
            progress()
            time.sleep(LOOK_EVERY_S)
        return False

    def _take(self, before: int, board: Board) -> None:
        """Take in how many cases there were and what they took."""
        result, (peak_MiB, grown_MiB, descriptors, accepted) = self.result, board.took
        result.cases = before + board.cases
        result.accepted += accepted
        result.peak_MiB = max(result.peak_MiB, peak_MiB)
        result.grown_MiB = max(result.grown_MiB, grown_MiB)
        result.descriptors = max(result.descriptors, descriptors)

    def _hear(self, said: Any) -> None:
        """Take in what the worker said."""
        said.seek(0)
        for line in said:
            with contextlib.suppress(ValueError):
                what = json.loads(line)
                self._found(what["found"], bytes.fromhex(what["data"]))

    def _blame(self, board: Board, hung: bool, code: int, errors: str) -> None:
        """The case at which the worker was stopped, or died."""
        if not board.cases:
            raise RuntimeError(f"the worker of {self._target} did not start, it ended with {code}: {errors}")
        if hung:
            self.result.hangs += 1
            self._found("does not end", board.data)
            return
        self.result.crashes += 1
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        self._found(f"the process died of {name}: {errors}", board.data)

    def _found(self, what: str, data: bytes) -> None:
        self._keep.mkdir(parents=True, exist_ok=True)
        path = self._keep / f"{self._target}-{hashlib.sha256(data).hexdigest()[:12]}"
        path.write_bytes(data)
        path.with_suffix(".txt").write_text(what + "\n", encoding="utf-8")
        self.result.findings.append(Finding(self._target, what, path))


def reproduce(target: Target, path: Path) -> str:
    """Try one kept input in this process; empty when all is well."""
    from tests.fuzz.target import judge

    return judge(target.check(), path.read_bytes())


def computing_s(pid: int) -> float:
    """Processor time that a process took so far [s]; 0 when it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _tail(errors: Any) -> str:
    errors.seek(max(0, os.fstat(errors.fileno()).st_size - 2000))
    return " ".join(errors.read().decode("utf-8", "replace").split())[-300:]
