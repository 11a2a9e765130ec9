"""Commands to the control process, executed between two ticks.

The parent sends (number, time, name, argument) through a pipe and announces it with SIGUSR1. Without an announcement
the pause after a tick costs one comparison: the loop neither polls the pipe nor waits for it.

    -> (7, 81234567890, "arm", None)          time of the request: CLOCK_MONOTONIC [ns]
    <- ("answer", (7, "ok", "arming"))        or the name and the text of an error

A command that the parent has reported as failed must not act. Every command except `disarm` and `stop` therefore
expires `VALID_FOR_S` after its request. The age of `arm` is checked after every precondition.
A stop, by pipe or by signal, outranks every `arm` that has not acted, also one requested up to `OUTRANKED_NS` later.
The death of the parent closes the pipe: that requests a ramp down, and no error of the pipe ends it.
"""

from multiprocessing.connection import Connection
from typing import Any

from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, ControlLoop, Segment, State, check_ready
from piezod.errors import CheckFailedError, PiezodError, TemporaryError
from piezod.runtime import clock
from piezod.transport import Link

NEVER_EXPIRE = ("disarm", "stop")
OUTRANKED_NS = 2_000_000_000
"""Time after a stop in which a requested `arm` is refused [ns]: its time stamp may be later than the request."""
VALID_FOR_S = 5.0  # age above which a command is refused [s]: half of the time that the parent waits for its answer


class CommandQueue:
    """Receives commands through a pipe and executes them in the control process.

    Parameters
    ----------
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
        self._urgent = ""
        self._arms_from_ns = 0

    def urge(self, name: str) -> None:
        """Note `stop` or `disarm`, to be executed after this tick; called from a signal handler.

        Every `arm` that was requested before expires now, even while it waits.
        """
        self._urgent = name if self._urgent != "stop" else "stop"
        self._withdraw_arms(name)
        self._announced = True

    def notify(self) -> None:
        """Note that a command is in the pipe; called from a signal handler."""
        self._announced = True

    def serve_pending(self) -> None:
        """Execute and answer every command in the pipe, if `notify` was called since the last time."""
        if not self._announced:
            return
        self._announced = False
        name, self._urgent = self._urgent, ""
        if name:
            self._rest(name)
        try:
            while self._pipe.poll():
                self._serve(*self._pipe.recv())
        except (EOFError, OSError):  # the parent is gone, and its last command with it
            self._loop.request_stop()

    def _withdraw_arms(self, name: str) -> None:
        """Refuse from now on each `arm` requested before this `disarm`, or within `OUTRANKED_NS` of this `stop`."""
        from_ns = clock.monotonic_ns() + (OUTRANKED_NS if name == "stop" else 1)
        self._arms_from_ns = max(self._arms_from_ns, from_ns)

    def _rest(self, name: str) -> str:
        """Execute `stop` or `disarm`."""
        self._withdraw_arms(name)
        supervisor = self._loop.supervisor
        supervisor.stop(fast=name == "stop")
        if name == "stop":
            self._loop.bring_down_left_output()
        return "ramping down" if supervisor.driving else f"{supervisor.state.name}: nothing is driven"

    def _serve(self, number: int, requested_ns: int, name: str, argument: Any) -> None:  # noqa: ANN401  # as in _execute
        """Execute and answer one command."""
        try:
            if name not in NEVER_EXPIRE:
                self._require_valid(name, requested_ns)
            kind, text = "ok", self._execute(name, argument, requested_ns)
        except PiezodError as error:
            kind, text = type(error).__name__, str(error)
        self._pipe.send(("answer", (number, kind, text)))

    def _require_valid(self, name: str, requested_ns: int) -> None:
        """Refuse an expired command, and every command after the request to end."""
        age_s = 1e-9 * (clock.monotonic_ns() - requested_ns)
        if age_s > VALID_FOR_S:
            raise CheckFailedError(
                f"{name}: {age_s:.1f} s have passed since the request, must be at most {VALID_FOR_S:g} s: the device "
                "or this machine is slow; nothing was done, try again"
            )
        if name == "arm" and requested_ns < self._arms_from_ns:
            raise CheckFailedError("arm: a stop came after the request or less than 2 s before it; nothing was done")
        if self._loop.stopped:
            raise TemporaryError(f"{name}: the control process is ending; try again")

    def _execute(self, name: str, argument: Any, requested_ns: int) -> str:  # noqa: ANN401  # any object of the parent
        match name:
            case "arm":
                return self._arm(requested_ns)
            case "disarm" | "stop":
                return self._rest(name)
            case "reset":
                return self._reset()
            case "limits":
                self._bench = self._bench.model_copy(update={"limits": argument})
                self._loop.set_limits(argument)
                return "limits taken"
            case "ring log":
                self._loop.ring_log.restore()
                return "ring log made again"
            case "end":
                self._require_disarmed(name)
                self._loop.request_stop()
                return "ending"
        raise CheckFailedError(f"'{name}' is not a command of the control process")

    def _arm(self, requested_ns: int) -> str:
        """Check every precondition, then the age of the command, then arm.

        A slow device delays no tick, because the bench is not driven yet. It delays the checks, so the age is compared
        after the checks.
        """
        self._require_disarmed("arm")
        if self._segment is None:
            raise CheckFailedError("arm: this session only reads")
        check_ready(self._bench, self._link)
        self._require_valid("arm", requested_ns)
        self._loop.arm(self._segment)
        return "arming"

    def _reset(self) -> str:
        supervisor = self._loop.supervisor
        if supervisor.state is not State.FAULT:
            raise CheckFailedError(f"reset: state is {supervisor.state.name}, must be FAULT; nothing to reset")
        if not self._loop.at_rest:
            raise CheckFailedError(
                f"reset: the amplifier reads back {self._link.reading.voltage_readback_V:.3g} V, must be within "
                f"{self._bench.arming.readback_within_V:g} V of {self._bench.limits.voltage_safe_V:g} V; ramp it down "
                "(piezod stop CONFIG)"
            )
        supervisor.reset(at_rest=True)
        return "fault reset; disarmed"

    def _require_disarmed(self, name: str) -> None:
        state = self._loop.supervisor.state
        if state is State.DISARMED:
            return
        advice = "piezod reset first" if state is State.FAULT else "piezod disarm first"
        fault = f" ({CAUSE_TEXT[self._loop.supervisor.fault]})" if state is State.FAULT else ""
        raise CheckFailedError(f"{name}: state is {state.name}{fault}, must be DISARMED; {advice}")
