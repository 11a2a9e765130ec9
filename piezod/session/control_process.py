"""The control process: one thread that reads, plans and writes; it hears commands in the pause after a tick.

Commands come through the pipe as (number, time, name, argument), announced by SIGUSR1, so that a tick neither asks nor
waits for them. SIGTERM asks for a ramp down and the end, a second one for haste.
"""

import contextlib
import ctypes
import os
import signal
import time
import warnings
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig, LimitsConfig, model_path
from piezod.control import CAUSE_TEXT, Cause, ControlLoop, RingLog, Segment, State, check_ready, real_time
from piezod.errors import CheckFailedError, PiezodError
from piezod.session.assembly import (
    Work,
    check_effects,
    check_wire,
    load_drivable,
    make_loop,
    make_rate_keeper,
    make_segment,
    opened_link,
)
from piezod.session.lock import BenchLock
from piezod.session.task import Outcome, Task
from piezod.transport import ExchangeResult, Link

ENERGISING = ("arm",)
OBEYS_WITHIN_S = 5.0  # half of what the parent waits for the answer
_PR_SET_PDEATHSIG = 1  # prctl(2): the signal that comes when the parent has died


def run(task: Task, pipe: Connection, lock: BenchLock) -> None:
    """Carry out `task`; ramps down when the process that started it dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            outcome = _carry_out(task, pipe)
        outcome.warnings = [str(warning.message) for warning in caught]
        with contextlib.suppress(BrokenPipeError):
            pipe.send(("done", outcome))
    except PiezodError as error:
        with contextlib.suppress(BrokenPipeError):
            pipe.send(("error", (type(error).__name__, str(error))))
    finally:
        lock.close()


def _carry_out(task: Task, pipe: Connection) -> Outcome:
    bench, model, works = task.bench, task.model, task.works
    if task.serves is not None:
        check_wire(bench)
        model = load_drivable(model_path(bench, task.serves))
        check_effects(bench, model, task.serves)
        works = (Work("bench reference", bench.compensation, reset_cycle=bench.arming.reset_cycle),)
    with opened_link(bench) as link, contextlib.ExitStack() as stack:
        clock = make_rate_keeper(bench, link)
        segments = [make_segment(work, bench, model, link, task.folder) for work in works]
        for segment in segments:
            stack.callback(segment.reference.close)
        if segments and task.serves is None:
            _warm_up(segments)
            check_ready(bench, link)
        ring = RingLog(bench.ring_log_path, round(bench.daemon.ring_seconds * bench.rate_Hz))
        stack.callback(ring.close)
        loop = make_loop(bench, link, clock, ring)
        desk = Desk(bench, link, loop, pipe, segments[0] if segments else None)
        signal.signal(signal.SIGTERM, lambda *_: loop.request_stop())
        signal.signal(signal.SIGUSR1, lambda *_: desk.ring())
        pipe.send(("ready", link.description))
        if task.serves is not None:  # disarmed as it is, nothing waits for it
            _warm_up(segments)
        with real_time(bench.real_time):
            fault = _work(loop, segments) if task.serves is None else _serve(loop, desk)
        results = {result.name.lower(): link.counts[result] for result in ExchangeResult if link.counts[result]}
        return Outcome(
            ticks=loop.counts.ticks,
            missed=clock.missed,
            failed_exchanges=loop.counts.failed_exchanges,
            results=results,
            fault="" if fault is Cause.NONE else _fault_text(fault, loop),
            stopped=loop.stopped,
            resident_kib=_resident_kib(),
            stale_bytes=link.stale_bytes,
            spikes=loop.supervisor.spikes,
            hint=link.hint,
        )


def _warm_up(segments: list[Segment]) -> None:
    """Have the compiled steps loaded, so that the first tick takes no longer than the others."""
    for segment in segments:
        segment.compensator.commit(segment.compensator.plan(0.0))
        segment.compensator.reset()


def _fault_text(fault: Cause, loop: ControlLoop) -> str:
    return f"{CAUSE_TEXT[fault]}: {loop.failure}" if fault is Cause.CONTROLLER else CAUSE_TEXT[fault]


def _serve(loop: ControlLoop, desk: "Desk") -> Cause:
    loop.serve(desk.attend)
    return loop.supervisor.fault


def _work(loop: ControlLoop, segments: list[Segment]) -> Cause:
    if not segments:
        loop.watch()
    for segment in segments:
        fault = loop.drive(segment)
        if fault is not Cause.NONE or loop.stopped:
            return fault
    return Cause.NONE


class Desk:
    """Where the control process takes commands, between two ticks.

    Parameters
    ----------
    bench, link, loop
        What is commanded.
    pipe
        Commands come, and answers go, through it.
    segment
        What is followed when armed.
    """

    def __init__(
        self, bench: BenchConfig, link: Link, loop: ControlLoop, pipe: Connection, segment: Segment | None
    ) -> None:
        self._bench, self._link, self._loop = bench, link, loop
        self._pipe, self._segment = pipe, segment
        self._rung = False

    def ring(self) -> None:
        """Note that a command waits; called from a signal handler."""
        self._rung = True

    def attend(self) -> None:
        """Answer what waits; costs nothing when nothing does."""
        if not self._rung:
            return
        self._rung = False
        while self._pipe.poll():
            number, sent_ns, name, argument = self._pipe.recv()
            try:
                if name in ENERGISING and time.monotonic_ns() - sent_ns > OBEYS_WITHIN_S * 1e9:
                    raise CheckFailedError(
                        f"{name}: came {OBEYS_WITHIN_S:g} s late; nobody may be waiting for it any more"
                    )
                kind, text = "ok", self._obey(name, argument)
            except PiezodError as error:
                kind, text = type(error).__name__, str(error)
            self._pipe.send(("answer", (number, kind, text)))

    def _obey(self, name: str, argument: Any) -> str:  # noqa: ANN401  # what the other end of the pipe sends
        supervisor = self._loop.supervisor
        match name:
            case "arm":
                return self._arm()
            case "disarm" | "stop":
                supervisor.stop(fast=name == "stop")
                return "ramping down" if supervisor.driving else f"{supervisor.state.name}: nothing is driven"
            case "reset":
                if supervisor.state is not State.FAULT:
                    raise CheckFailedError(f"reset: state is {supervisor.state.name}, must be FAULT; nothing to reset")
                supervisor.reset()
                return "fault reset; disarmed"
            case "limits":
                return self._take(argument)
            case "end":
                self._require_disarmed(name)
                self._loop.request_stop()
                return "ending"
        raise CheckFailedError(f"'{name}' is no command of the control process")

    def _arm(self) -> str:
        """Check every precondition, then start; a device that is slow now delays nothing: nothing is driven."""
        self._require_disarmed("arm")
        if self._segment is None:
            raise CheckFailedError("arm: this session only reads")
        check_ready(self._bench, self._link)
        self._loop.arm(self._segment)
        return "arming"

    def _require_disarmed(self, name: str) -> None:
        state = self._loop.supervisor.state
        if state is State.DISARMED:
            return
        advice = "piezod reset first" if state is State.FAULT else "piezod disarm first"
        fault = f" ({CAUSE_TEXT[self._loop.supervisor.fault]})" if state is State.FAULT else ""
        raise CheckFailedError(f"{name}: state is {state.name}{fault}, must be DISARMED; {advice}")

    def _take(self, limits: LimitsConfig) -> str:
        self._bench = self._bench.model_copy(update={"limits": limits})
        self._loop.set_limits(limits)
        return "limits taken"


def _resident_kib() -> int:
    """Resident memory of this process now [KiB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024
