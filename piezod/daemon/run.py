"""A service in the foreground: `piezod run`, started by systemd or by hand, and every command that drives."""

import asyncio
import atexit
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from piezod.config import BenchConfig, load_bench
from piezod.config.sections import RecorderConfig
from piezod.daemon.journal import JOURNAL, log_line
from piezod.errors import PiezodError, TemporaryError, system_error_text
from piezod.recorder.recording_files import SUFFIX, recording_files, remove_folder
from piezod.recording import write_recording
from piezod.runtime import clock, signals
from piezod.session.heat_file import HeatFile
from piezod.session.history import History, OnRows
from piezod.session.lock import lock_bench
from piezod.session.session import Session
from piezod.session.task import Outcome, Program, SegmentSpec, Task

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from piezod.daemon.preview import MissingPreview
    from piezod.daemon.service import Service
    from piezod.daemon.statistics import TrackingError
    from piezod.model import Model

SYNC_EVERY_S = 0.05  # time between two writes of the rows of a command to the disk [s]
_UNSAVED: list[tuple[Path, str]] = []  # folders of rows that no file of this command holds yet, and their benches


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Parameters
    ----------
    outcome
        Outcome of the last session.
    tracking
        Tracking error over all sessions.
    drift
        Result of the comparison with the model; None without one.
    preview
        Cost of a live reference; None without one.
    """

    outcome: Outcome
    tracking: "TrackingError"
    drift: dict[str, object] | None = None
    preview: "MissingPreview | None" = None

    @property
    def exit_code(self) -> int:
        """0, or 1 after a fault."""
        return 1 if self.outcome.fault else 0

    def as_dict(self) -> dict[str, object]:
        """Result as JSON values."""
        tracking = self.tracking
        return {
            "schema": "piezod.run/1",
            **self.outcome.__dict__,
            "tracking": {"ticks": tracking.ticks, "rms_error_N": tracking.rms_N, "max_error_N": tracking.max_N},
            "drift": self.drift,
            "preview": None if self.preview is None else self.preview.as_dict(),
        }


def run_foreground(path: Path, *, arm: bool) -> RunResult:
    """Run a bench until a signal ends it; with `arm` until its reference ends or a fault latches.

    Parameters
    ----------
    arm
        Whether to arm at once.

    Raises
    ------
    PiezodError
        The bench could not be started; nothing was written to the device.
    """
    bench = load_bench(path)
    size = 0
    if bench.learning is not None:
        from piezod.session.assembly import correction_size  # noqa: PLC0415  # slow import that other benches do not need

        size = correction_size(bench, path.parent)

    service = _serve(path, Task(bench, None, path.parent, (), path), arm=arm, on_rows=None, correction_size=size)
    _log_result(service.outcome, service.statistics.tracking)
    watch = service.model_watch
    if watch.preview is not None:
        log_line(watch.preview.message())
    JOURNAL.flush()
    return RunResult(service.outcome, service.statistics.tracking, watch.last_drift, watch.preview)


def drive(
    path: Path,
    bench: BenchConfig,
    model: "Model | None",
    segments: list[SegmentSpec],
    on_rows: OnRows,
    program: Program | None = None,
    *,
    keeps_rows: bool = True,
) -> tuple[History, Outcome]:
    """Drive segments, or a program, and collect every row.

    A fault, a stop from any side, SIGINT, SIGTERM or SIGHUP ends it at rest. The end of the control process counts as a
    fault once there are rows.

    Parameters
    ----------
    path
        Bench file; relative paths start from its folder.
    bench, model
        Its configuration, and the model of the segments that name none.
    program
        Drive in place of segments; None: drive `segments`.
    on_rows
        Called about ten times per second with new rows.
    keeps_rows
        Whether a recorder writes the rows to a folder, if the bench has no recorder. It stays until `rows_are_saved`.

    Raises
    ------
    PiezodError
        The bench could not be connected, or the session failed.
    """
    history = History()

    def add(rows: "NDArray[np.void]") -> None:
        history.add(rows)
        on_rows(rows)

    is_unfinished = keeps_rows and bench.recorder is None
    if is_unfinished:
        folder = time.strftime(f"{bench.name}-unfinished-%Y%m%dT%H%M%SZ", time.gmtime(clock.wall_s()))
        bench = bench.model_copy(update={"recorder": RecorderConfig(folder=folder, sync_every_s=SYNC_EVERY_S)})
    task = Task(bench, model, path.parent, tuple(segments), program=program)
    JOURNAL.is_quiet = True
    try:
        outcome = _serve(path, task, arm=False, on_rows=add, is_unfinished=is_unfinished).outcome
    except PiezodError as error:
        if not history.rows.size:
            raise
        outcome = Outcome(fault=str(error))
    finally:
        JOURNAL.is_quiet = False
        if is_unfinished and bench.recordings_path is not None:
            _UNSAVED.append((bench.recordings_path, bench.name))
            try:
                _write_rows(history, bench.recordings_path, bench.name)
            except (OSError, PiezodError):  # the files of the command are still to come
                _UNSAVED.pop()
    return history, outcome


def _write_rows(history: History, folder: Path, bench: str) -> None:
    """Write what a drive has that ended before its recorder began; remove the folder of one without rows."""
    if not history.rows.size:
        rows_are_saved()
    elif not (folder.exists() and recording_files(folder, bench)):
        folder.mkdir(exist_ok=True)
        for number in range(int(history.rows["segment"].max()) + 1):
            part = history.recording(number, metadata={"bench": bench})
            if part.time_s.size:
                write_recording(part, folder / f"{bench}-{number + 1:06d}{SUFFIX}")


def rows_are_saved() -> None:
    """Remove the rows that the drives of this process left on the disk: the files of the command hold them by now."""
    while _UNSAVED:
        remove_folder(*_UNSAVED.pop())


@atexit.register
def _name_unsaved_rows() -> None:
    for folder, _ in _UNSAVED:
        log_line(f"{folder.absolute()} holds the rows of the drive; piezod convert reads them")
    JOURNAL.flush()


def _serve(
    path: Path, task: Task, *, arm: bool, on_rows: OnRows | None, correction_size: int = 0, is_unfinished: bool = False
) -> "Service":
    """Run a service from the lock of its bench to the end, and keep the heat of the stack.

    The heat of a session that ended without a word is not kept: the stack may be as hot as its limit allows.
    """
    bench = task.bench
    lock = lock_bench(bench)
    heat_file = HeatFile(bench)
    task = replace(task, heat_W=heat_file.pop())
    session = Session(task, lock, correction_size=correction_size)
    before = {number: signals.handler(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        session.launch()
        from piezod.daemon.service import Service  # noqa: PLC0415  # slow import, while the control process starts

        if on_rows is None:
            _check_files(bench)
        service = Service(path, bench, lock, session, arm=arm, on_rows=on_rows, is_unfinished=is_unfinished)
        service.outcome.heat_W = task.heat_W
        ended = False
        try:
            asyncio.run(service.run())
            ended = True
        finally:
            if ended or service.statistics.last is None:  # without a tick nothing was driven
                heat_file.keep(service.outcome.heat_W)
    except OSError as error:
        raise TemporaryError(f"{path}: {system_error_text(error)}") from error
    finally:
        session.close()
        lock.close()
        JOURNAL.flush()
        if on_rows is not None:  # the command goes on; a daemon ends
            for number, handler in before.items():
                signals.handle(number, handler)
    return service


def _check_files(bench: BenchConfig) -> None:
    """Refuse files of another origin at the paths that the daemon writes."""
    from piezod.daemon.drift import blocks_file, drift_file  # noqa: PLC0415  # slow import, as above
    from piezod.session.learned_file import learned_file  # noqa: PLC0415

    if bench.drift is not None:
        drift_file(bench).check()
        blocks_file(bench).check()
    if bench.learning is not None:
        learned_file(bench).check()


def _log_result(outcome: Outcome, tracking: "TrackingError") -> None:
    for warning in outcome.warnings:
        log_line(f"warning: {warning}")
    failed = ", ".join(f"{name} {count}" for name, count in outcome.results.items() if name != "ok")
    log_line(
        f"{outcome.ticks} ticks, {outcome.missed} missed, {outcome.failed_exchanges} failed exchanges {failed}".rstrip()
    )
    if outcome.stale_bytes:
        log_line(f"{outcome.stale_bytes} bytes unasked or late, discarded")
    if outcome.spikes:
        log_line(f"{outcome.spikes} spikes of the force, ignored")
    if outcome.hint:
        log_line(f"link: {outcome.hint}")
    if tracking.ticks:
        log_line(f"tracking: rms error {tracking.rms_N:.3f} N, max {tracking.max_N:.3f} N over {tracking.ticks} ticks")
    if outcome.fault:
        log_line(f"FAULT: {outcome.fault}")
