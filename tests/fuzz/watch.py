"""The parent of a worker: counts cases, stores failed inputs, ends hanging cases, restarts after a crash."""

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

from tests.fuzz.shared_progress import SharedProgress
from tests.fuzz.target import Target

ROOT = Path(__file__).parents[2]
HANGS_AFTER_S = 10.0  # of processor time; a case takes milliseconds
ASLEEP = 30  # factor for the wall clock, which allows for a busy machine and standstills
START_S = 600.0
MOST_RESTARTS = MOST_FINDINGS = 20
LOOK_EVERY_S = 0.05


@dataclass(frozen=True)
class Finding:
    """An input with a violation: its target, the violation and the path of the stored input."""

    target: str
    what: str
    path: Path

    def text(self) -> str:
        """Summary, with the command that repeats the case."""
        lines = self.what.splitlines()
        where = next((line.strip() for line in reversed(lines) if line.strip().startswith("File ")), "")
        return (
            f"{self.target}: {lines[-1][:300]} {where}\n    python -m tests.fuzz --reproduce {self.target} {self.path}"
        )


@dataclass
class Result:
    """Result of a run of one target."""

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
    """Runs workers for one target.

    Parameters
    ----------
    module, target
        Name of the target, and the module that holds it.
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
        """Try `count` cases; starts a new worker after each crash or hang."""
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
        """Watch one worker until it ends; returns whether it ended normally."""
        shared, before = SharedProgress(folder / "progress"), self.result.cases
        shared.idle()
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
        with (folder / "output").open("w+b") as output, (folder / "errors").open("w+b") as errors:
            process = subprocess.Popen(command, cwd=ROOT, stdout=output, stderr=errors, start_new_session=True)
            try:
                hung = self._wait(process, shared, lambda: on_progress(before + shared.cases))
            finally:
                if process.poll() is None:
                    process.kill()
                code = process.wait()
            self._read_progress(before, shared)
            self._read_findings(output)
            if hung or code != 0:
                self._record_failure(shared, hung, code, _tail(errors))
        shared.close()
        return not hung and code == 0

    def _wait(self, process: subprocess.Popen[bytes], shared: SharedProgress, progress: Callable[[], None]) -> bool:
        """Wait for the end of the worker; returns True when a case hangs."""
        begun_s, case, computed_s = time.monotonic(), 0, 0.0
        while process.poll() is None:
            if shared.cases != case:
                case, computed_s = shared.cases, computing_s(process.pid)
            late_s = time.monotonic() - begun_s if case == 0 else 0.0
            hung = shared.age_s > self._hangs_after_s and computing_s(process.pid) - computed_s > self._hangs_after_s
            if hung or shared.age_s > ASLEEP * self._hangs_after_s or late_s > START_S:
                return True
            progress()
            time.sleep(LOOK_EVERY_S)
        return False

    def _read_progress(self, before: int, shared: SharedProgress) -> None:
        """Add the counts and resources of the worker to the result."""
        result, (peak_MiB, grown_MiB, descriptors, accepted) = self.result, shared.took
        result.cases = before + shared.cases
        result.accepted += accepted
        result.peak_MiB = max(result.peak_MiB, peak_MiB)
        result.grown_MiB = max(result.grown_MiB, grown_MiB)
        result.descriptors = max(result.descriptors, descriptors)

    def _read_findings(self, output: Any) -> None:
        """Read the findings that the worker printed."""
        output.seek(0)
        for line in output:
            with contextlib.suppress(ValueError):
                what = json.loads(line)
                self._found(what["found"], bytes.fromhex(what["data"]))

    def _record_failure(self, shared: SharedProgress, hung: bool, code: int, errors: str) -> None:
        """Record the case at which the worker hung or crashed."""
        if not shared.cases:
            raise RuntimeError(f"the worker of {self._target} did not start, it ended with {code}: {errors}")
        if hung:
            self.result.hangs += 1
            self._found("does not end", shared.data)
            return
        self.result.crashes += 1
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        self._found(f"the process died of {name}: {errors}", shared.data)

    def _found(self, what: str, data: bytes) -> None:
        self._keep.mkdir(parents=True, exist_ok=True)
        path = self._keep / f"{self._target}-{hashlib.sha256(data).hexdigest()[:12]}"
        path.write_bytes(data)
        path.with_suffix(".txt").write_text(what + "\n", encoding="utf-8")
        self.result.findings.append(Finding(self._target, what, path))


def reproduce(target: Target, path: Path) -> str:
    """Try one stored input in this process; returns the violation or an empty text."""
    from tests.fuzz.target import find_violation

    return find_violation(target.check(), path.read_bytes())


def computing_s(pid: int) -> float:
    """Processor time of a process [s]; 0 when it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _tail(errors: Any) -> str:
    errors.seek(max(0, os.fstat(errors.fileno()).st_size - 2000))
    return " ".join(errors.read().decode("utf-8", "replace").split())[-300:]
