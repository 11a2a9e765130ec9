"""Commands to the control process, executed between two ticks.

The parent sends (number, time, name, argument) through a pipe and announces it with SIGUSR1. Without an announcement
the pause after a tick costs one comparison: the loop neither polls the pipe nor waits for it.

    -> (7, 81234567890, "arm", None)          time: CLOCK_MONOTONIC [ns]
    <- ("answer", (7, "ok", "arming"))        or the name and the text of an error
"""

import time
from multiprocessing.connection import Connection
from typing import Any

from piezod.config import BenchConfig, LimitsConfig
from piezod.control import CAUSE_TEXT, ControlLoop, Segment, State, check_ready
from piezod.errors import CheckFailedError, PiezodError
from piezod.transport import Link

ENERGISING = ("arm",)
VALID_FOR_S = 5.0
"""Age above which an energising command is refused [s]: half of the time that the parent waits for its answer."""


class CommandQueue:
    """Receives commands through a pipe and executes them in the control process.

    Parameters
    ----------
    bench
        Bench configuration.
    link, loop
        Opened link and the loop that drives through it.
    pipe
        Connection to the parent, for commands and answers.
    segment
        Segment that `arm` starts; None: `arm` is refused.
    """

    def __init__(
        self, bench: BenchConfig, link: Link, loop: ControlLoop, pipe: Connection, segment: Segment | None
    ) -> None:
        self._bench, self._link, self._loop = bench, link, loop
        self._pipe, self._segment = pipe, segment
        self._announced = False

    def notify(self) -> None:
        """Note that a command is in the pipe; called from a signal handler."""
        self._announced = True

    def serve_pending(self) -> None:
        """Execute and answer every command in the pipe, if `notify` was called since the last time."""
        if not self._announced:
            return
        self._announced = False
        while self._pipe.poll():
            number, sent_ns, name, argument = self._pipe.recv()
            try:
                age_s = 1e-9 * (time.monotonic_ns() - sent_ns)
                if name in ENERGISING and age_s > VALID_FOR_S:
                    raise CheckFailedError(
                        f"{name}: received {age_s:.1f} s after it was sent, must be at most {VALID_FOR_S:g} s; send it "
                        "again"
                    )
                kind, text = "ok", self._execute(name, argument)
            except PiezodError as error:
                kind, text = type(error).__name__, str(error)
            self._pipe.send(("answer", (number, kind, text)))

    def _execute(self, name: str, argument: Any) -> str:  # noqa: ANN401  # any object that the parent sends
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
                return self._change_limits(argument)
            case "end":
                self._require_disarmed(name)
                self._loop.request_stop()
                return "ending"
        raise CheckFailedError(f"'{name}' is not a command of the control process")

    def _arm(self) -> str:
        """Check every precondition, then arm. A slow device delays no tick, because nothing is driven yet."""
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

    def _change_limits(self, limits: LimitsConfig) -> str:
        self._bench = self._bench.model_copy(update={"limits": limits})
        self._loop.set_limits(limits)
        return "limits taken"
