"""The control process: its set-up, and its single thread that reads, plans and writes.

SIGTERM requests a ramp down and the end, however often it comes: the kernel may send it more than once when the parent
dies. SIGUSR2 requests the fastest ramp within the slew limit. SIGUSR1 announces a command
(`session/command_queue.py`). The signals of `task.URGENT` are the commands `disarm` and `stop` themselves.
Nothing that concerns the parent ends a ramp: a closed pipe only requests one.
"""

import contextlib
import gc
import os
import signal
import sys
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from piezod.config import model_path
from piezod.control import (
    CAUSE_TEXT,
    Cause,
    ControlLoop,
    PhaseTimes,
    RingLog,
    Segment,
    TableReference,
    check_ready,
    real_time,
)
from piezod.control.references.repeat_correction import RepeatCorrection
from piezod.errors import PiezodError, TemporaryError, system_error_text
from piezod.model import Model
from piezod.runtime import processes, signals
from piezod.session.assembly import (
    check_effects,
    check_wire,
    load_drivable_model,
    make_loop,
    make_rate_keeper,
    make_segment,
    opened_link,
)
from piezod.session.command_queue import CommandQueue
from piezod.session.device_names import device_names
from piezod.session.files import files_digest
from piezod.session.learned_file import LearnedFile
from piezod.session.lock import BenchLock
from piezod.session.task import URGENT, Outcome, Ready, SegmentSpec, SharedMemory, Task
from piezod.transport import ExchangeResult, Link


def run(task: Task, pipe: Connection, lock: BenchLock, shared: SharedMemory) -> None:
    """Execute a task and send its outcome, or its error, to the parent.

    When the parent dies, the bench is ramped down and the process ends.

    Parameters
    ----------
    pipe
        Connection to the parent. It carries `ready`, `answer`, and finally `done` or `error`.
    lock
        Lock of the bench; this process holds it until its end.
    shared
        Memory for the times of the phases of a tick, a learned correction, and the last failed exchange.
    """
    signals.handle(signal.SIGINT, signal.SIG_IGN)
    signals.handle(signal.SIGHUP, signal.SIG_IGN)
    for number in URGENT.values():
        signals.handle(number, signal.SIG_IGN)  # the bench is not driven yet
    if not processes.end_with_parent(signal.SIGTERM):
        lock.close()
        return
    try:
        lock.cover(device_names(task.bench.link))  # again: a name may resolve to another address, a reload name another
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            outcome = _execute(task, pipe, shared)
        outcome.warnings = [str(warning.message) for warning in caught]
        _send(pipe, ("done", outcome))
    except PiezodError as error:
        _send(pipe, ("error", (type(error).__name__, str(error))))
    except OSError as error:
        _send(pipe, ("error", (TemporaryError.__name__, system_error_text(error))))
    finally:
        lock.close()
        gc.freeze()  # the end of the interpreter visits every object otherwise, which takes 0.2 s


def _send(pipe: Connection, message: tuple[str, Any]) -> bool:
    """Send a message to the parent; False when the parent is gone."""
    try:
        pipe.send(message)
    except OSError:
        return False
    return True


def _execute(task: Task, pipe: Connection, shared: SharedMemory) -> Outcome:
    """Connect the bench, build its loop, and drive the segments or serve commands."""
    bench = task.bench
    files = "" if task.serves is None else files_digest(bench, task.serves)
    model, specs = _model_and_segments(task)
    with opened_link(bench, shared.bad_exchange) as link, contextlib.ExitStack() as stack:
        clock = make_rate_keeper(bench, link)
        segments = [make_segment(spec, bench, model, link, task.folder) for spec in specs]
        for segment in segments:
            stack.callback(segment.reference.close)
        if shared.correction is not None:
            _correct_by(segments[0], shared.correction, task)
        if segments and task.serves is None:
            _warm_up(segments)
            check_ready(bench, link)
        rows = round(bench.daemon.ring_seconds * bench.rate_Hz)
        ring_log = RingLog(bench.ring_log_path, rows, bench.daemon.socket_group)
        stack.callback(ring_log.close)
        driven = link if task.program is None else task.program.prepare(bench, link, clock)
        loop = make_loop(bench, driven, clock, ring_log, PhaseTimes(shared.phases))
        loop.supervisor.heat_W = task.heat_W
        for segment in segments[:1]:
            loop.observe(segment, ring_log)
        commands = CommandQueue(bench, link, loop, pipe, segments[0] if segments else None)
        if task.serves is not None:  # before `ready`: an `arm` that arrives now would wait until it is too old
            _warm_up(segments)
        signals.handle(signal.SIGTERM, lambda *_: loop.request_stop())
        signals.handle(signal.SIGUSR2, lambda *_: loop.request_stop(fast=True))
        signals.handle(signal.SIGUSR1, lambda *_: commands.notify())
        for name, number in URGENT.items():
            signals.handle(number, lambda *_, name=name: _urge(name, task, loop, commands))
        if not _send(pipe, ("ready", Ready(link.description, files))):
            loop.request_stop()
        with real_time(bench.real_time):
            returned = _run(task, loop, segments, commands)
        outcome = _outcome(link, loop, clock.missed)
        outcome.returned = returned
        return outcome


def _correct_by(segment: Segment, cells: Any, task: Task) -> None:  # noqa: ANN401  # an array of ctypes
    """Add the learned correction to the looped table of a segment, beginning with the correction of an earlier run."""
    assert isinstance(segment.reference, TableReference)
    assert task.serves is not None
    correction = RepeatCorrection(cells)
    segment.reference.correct_by(correction)
    if (earlier_N := LearnedFile(task.bench, task.serves, segment.reference).read()) is not None:
        correction.offer(earlier_N)


def _model_and_segments(task: Task) -> tuple[Model | None, tuple[SegmentSpec, ...]]:
    """Return model and segments of the task; a served bench has one segment, its own reference."""
    bench = task.bench
    if task.serves is None:
        return task.model, task.segments
    check_wire(bench)
    model = load_drivable_model(model_path(bench, task.serves))
    check_effects(bench, model, task.serves)
    spec = SegmentSpec("bench reference", bench.compensation, reset_cycle=bench.arming.reset_cycle)
    return model, (spec,)


def _warm_up(segments: list[Segment]) -> None:
    """Load the compiled steps, so that the first tick takes as long as the others.

    Numba would import scipy.linalg for matrix products, which no step has. That takes 0.2 s and 20 MB.
    """
    sys.modules.setdefault("scipy.linalg", None)  # type: ignore[arg-type]  # an import of it raises ImportError
    for segment in segments:
        segment.compensator.commit(segment.compensator.plan(0.0))
        segment.compensator.reset()


def _urge(name: str, task: Task, loop: ControlLoop, commands: CommandQueue) -> None:
    """Execute `stop` or `disarm`: they end a drive of segments, and a served bench stays, disarmed."""
    if task.serves is None:
        loop.request_stop(fast=name == "stop")
    else:
        commands.urge(name)


def _run(task: Task, loop: ControlLoop, segments: list[Segment], commands: CommandQueue) -> object:
    """Serve commands, run the program and return its result, or drive the segments until a stop or a fault."""
    if task.program is not None:
        return task.program.run(loop)
    if task.serves is not None:
        loop.serve(commands.serve_pending)
        return None
    for segment in segments:
        if loop.drive(segment) is not Cause.NONE or loop.stopped:
            break
    return None


def _outcome(link: Link, loop: ControlLoop, missed: int) -> Outcome:
    return Outcome(
        ticks=loop.counts.ticks,
        missed=missed,
        failed_exchanges=loop.counts.failed_exchanges,
        results={result.name.lower(): link.counts[result] for result in ExchangeResult if link.counts[result]},
        fault=_fault_text(loop),
        stopped=loop.stopped,
        resident_kib=_resident_kib(),
        stale_bytes=link.stale_bytes,
        spikes=loop.supervisor.spikes,
        hint=link.hint,
        heat_W=loop.supervisor.heat_W,
    )


def _fault_text(loop: ControlLoop) -> str:
    """Text of the latched fault; empty without one."""
    fault = loop.supervisor.fault
    text = "" if fault is Cause.NONE else CAUSE_TEXT[fault]
    return f"{text}: {loop.failure}" if fault is Cause.CONTROLLER else text


def _resident_kib() -> int:
    """Resident memory of this process now [KiB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024
