"""Diagnosis of an archive: each recording with the model that the recording before it gave, benches in parallel.

A recording counts as diagnosed if neither its content nor its given model has changed since the diagnosis. So a
stopped run continues. A changed recording is diagnosed again, with all later recordings whose given model changes.
"""

import json
import shutil
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from piezod.history.archive import MARK, ArchivedRecording, Bench
from piezod.history.worker import MODEL, SCHEMA, TASK
from piezod.model import file_sha256
from piezod.runtime.files import written, written_folder
from piezod.tasks.cluster import run_tasks
from piezod.tasks.task import RUN, Outcome, Task, failed_outcome

FINDINGS = "findings.json"
WORKER = "piezod.history.worker"

OnRecording = Callable[[str | None, int, int], None]


@dataclass(frozen=True)
class Diagnosed:
    """A diagnosed recording.

    Parameters
    ----------
    folder
        Folder with its findings and its model.
    findings
        Content of its `findings.json`; None: it could not be diagnosed.
    failed
        Reason in one line; None: it was diagnosed.
    cpu_s
        Processor time [s].
    """

    recording: ArchivedRecording
    folder: Path
    findings: dict[str, Any] | None
    failed: str | None
    cpu_s: float


@dataclass
class BenchRun:
    """A bench during a run: its diagnosed recordings, and the newest model."""

    bench: Bench
    folder: Path
    done: list[Diagnosed] = field(default_factory=list)
    model_path: Path = Path()
    is_running: bool = False

    def __post_init__(self) -> None:
        self.model_path = self.bench.model_path
        while self.next is not None and (known := self._known(self.next)) is not None:
            self.accept(known)

    @property
    def next(self) -> ArchivedRecording | None:
        """First recording that is not diagnosed."""
        remaining = self.bench.recordings[len(self.done) :]
        return remaining[0] if remaining else None

    @property
    def remaining(self) -> int:
        """Number of recordings that are not diagnosed."""
        return len(self.bench.recordings) - len(self.done)

    @property
    def model_paths(self) -> list[Path]:
        """Model of the bench, and each model that a recording changed."""
        paths, known = [self.bench.model_path], {file_sha256(self.bench.model_path)}
        for diagnosed in self.done:
            path = diagnosed.folder / MODEL
            if path.is_file() and (sha256 := file_sha256(path)) not in known:
                paths.append(path)
                known.add(sha256)
        return paths

    def accept(self, diagnosed: Diagnosed) -> None:
        """Count the next recording as diagnosed; its model is given to the recording after it."""
        self.done.append(diagnosed)
        self.is_running = False
        if (diagnosed.folder / MODEL).is_file():
            self.model_path = diagnosed.folder / MODEL

    def task(self) -> Task | Outcome:
        """Task for the next recording, with the newest model, and with the identification if the model needs it."""
        recording = self.next
        assert recording is not None
        self.is_running = True
        stated = {
            "recording": recording.path.name,
            "recording_sha256": recording.sha256,
            "given_sha256": file_sha256(self.model_path),
        }
        files = {TASK: json.dumps(stated).encode()}
        try:
            files |= {MODEL: self.model_path.read_bytes(), recording.path.name: recording.path.read_bytes()}
            if self.bench.model.information is None:
                files |= {path.name: path.read_bytes() for path in self._identification() if path.is_file()}
        except OSError as error:
            return failed_outcome(self.bench.name, f"{error.filename}: cannot be read: {error.strerror}")
        return Task(self.bench.name, {name: zlib.compress(content, 1) for name, content in files.items()}, WORKER)

    def save(self, outcome: Outcome) -> Diagnosed:
        """Write the outcome of the next recording, and count it as diagnosed.

        A process that died leaves no file, so a later run tries its recording again.
        """
        recording = self.next
        assert recording is not None
        target = self.folder / recording.path.name
        if outcome.files:
            written_folder(target, outcome.files)
        else:
            shutil.rmtree(target, ignore_errors=True)
        diagnosed = _read(recording, target) or Diagnosed(recording, target, None, outcome.failed, 0.0)
        self.accept(diagnosed)
        return diagnosed

    def _known(self, recording: ArchivedRecording) -> Diagnosed | None:
        """Diagnosis of a recording by an earlier run; None: there is none, or of other contents."""
        target = self.folder / recording.path.name
        try:
            run = json.loads((target / RUN).read_text(encoding="utf-8"))
            same = run["recording"] == recording.sha256 and run["given"] == file_sha256(self.model_path)
        except (OSError, ValueError, KeyError):
            return None
        return _read(recording, target) if same else None

    def _identification(self) -> list[Path]:
        folder = self.bench.model_path.parent
        return [folder / Path(entry.path).name for entry in self.bench.model.provenance.recordings]


def diagnose_archive(
    benches: Sequence[Bench], output: Path, *, jobs: int | None, scheduler: str | None, on_recording: OnRecording
) -> list[BenchRun]:
    """Diagnose all recordings that are not diagnosed yet.

    Parameters
    ----------
    output
        Folder for the diagnoses; created if missing.
    jobs
        Number of processes on this machine, at least 1; None: one per core.
    scheduler
        Address of a Dask scheduler; None: this machine.
    on_recording
        Called with a line on a recording that cannot be diagnosed or None, recordings done and to do in this run.

    Raises
    ------
    ConfigurationError
        The folder cannot be written.
    UnreachableError
        The scheduler does not answer.
    """
    written(output / MARK, json.dumps({"schema": SCHEMA}) + "\n", parents=True)
    runs = {bench.name: BenchRun(bench, output / bench.name) for bench in benches}
    wanted, done = sum(run.remaining for run in runs.values()), 0

    def next_task() -> Task | Outcome | None:
        """Next recording of the bench with the most recordings left, of those where none is in work."""
        ready = [run for run in runs.values() if run.remaining and not run.is_running]
        return max(ready, key=lambda run: run.remaining).task() if ready else None

    if wanted:
        on_recording(None, 0, wanted)
    with run_tasks(next_task, jobs, scheduler) as outcomes:
        for outcome in outcomes if wanted else ():
            diagnosed = runs[outcome.name].save(outcome)
            done += 1
            failed = None
            if diagnosed.failed is not None:
                failed = f"{outcome.name}/{diagnosed.recording.path.name}: {diagnosed.failed}"
            on_recording(failed, done, wanted)
    return list(runs.values())


def _read(recording: ArchivedRecording, folder: Path) -> Diagnosed | None:
    """Diagnosis in a folder; None: it is not complete."""
    try:
        run = json.loads((folder / RUN).read_text(encoding="utf-8"))
        findings = None if run["failed"] else json.loads((folder / FINDINGS).read_text(encoding="utf-8"))
        return Diagnosed(recording, folder, findings, run["failed"], float(run["cpu_s"]))
    except (OSError, ValueError, KeyError):
        return None
