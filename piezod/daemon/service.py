"""`piezod run`: the bench in the foreground. The control process drives; this one says what happens."""

import signal
import sys
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from types import FrameType

import numpy as np
from numpy.typing import NDArray

from piezod.control import CAUSE_TEXT, Cause, State
from piezod.daemon.assembly import Work, load
from piezod.daemon.history import GOOD
from piezod.daemon.session import Outcome, Session


@dataclass(frozen=True)
class RunResult:
    """What a run came to."""

    outcome: Outcome
    tracking: "TrackingError"

    @property
    def exit_code(self) -> int:
        """0, or 1 after a fault."""
        return 1 if self.outcome.fault else 0

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        tracking = self.tracking
        return {
            "schema": "piezod.run/1",
            **self.outcome.__dict__,
            "tracking": {"ticks": tracking.ticks, "rms_error_N": tracking.rms_N, "max_error_N": tracking.max_N},
        }


class TrackingError:
    """Error of force against reference, summed up as it goes, in memory that does not grow."""

    def __init__(self) -> None:
        self.ticks = 0
        self.max_N = 0.0
        self._sum_of_squares = 0.0
        self._last: np.void | None = None

    @property
    def rms_N(self) -> float:
        """Root of the mean square so far [N]; nan before the first tick."""
        return sqrt(self._sum_of_squares / self.ticks) if self.ticks else float("nan")

    def add(self, rows: NDArray[np.void]) -> None:
        """Take in new rows; a force answers the command one row before it."""
        if not rows.size:
            return
        joined = rows if self._last is None else np.concatenate((np.atleast_1d(self._last), rows))
        self._last = rows[-1].copy()
        commands, answers = joined[:-1], joined[1:]
        followed = (
            (commands["state"] == State.RUNNING) & (answers["state"] == State.RUNNING) & (answers["result"] == GOOD)
        )
        error = answers["force_N"][followed] - commands["reference_N"][followed]
        if error.size:
            self.ticks += int(error.size)
            self._sum_of_squares += float(np.sum(error**2))
            self.max_N = max(self.max_N, float(np.abs(error).max()))


def run_foreground(path: Path, *, arm: bool) -> RunResult:
    """Run a bench until its reference ends, a fault latches, or a signal asks for a ramp down.

    Parameters
    ----------
    path
        Bench configuration.
    arm
        Drive; else only read until stopped.

    Raises
    ------
    PiezodError
        The bench could not be had; nothing was written.
    """
    bench, model = load(path)
    works = [Work("bench reference", bench.compensation, reset_cycle=bench.arming.reset_cycle)] if arm else []
    session = Session(bench, model, path.parent, works)

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001  # the signature signal handlers have
        session.stop()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    teller, tracking = _Teller(), TrackingError()
    try:
        session.start()
        _say(f"{bench.name}: {bench.rate_Hz:g} Hz, {'armed' if arm else 'reading only; --arm to drive'}")
        for rows in session.follow():
            teller.tell(rows)
            tracking.add(rows)
    finally:
        session.close()
    _sum_up(session.outcome, tracking)
    return RunResult(session.outcome, tracking)


def _sum_up(outcome: Outcome, tracking: TrackingError) -> None:
    for warning in outcome.warnings:
        _say(f"warning: {warning}")
    failed = ", ".join(f"{name} {count}" for name, count in outcome.results.items() if name != "ok")
    _say(
        f"{outcome.ticks} ticks, {outcome.missed} missed, {outcome.failed_exchanges} failed exchanges {failed}".rstrip()
    )
    if tracking.ticks:
        _say(f"tracking: rms error {tracking.rms_N:.3f} N, max {tracking.max_N:.3f} N over {tracking.ticks} ticks")
    if outcome.fault:
        _say(f"FAULT: {outcome.fault}")


class _Teller:
    """Says every transition once."""

    def __init__(self) -> None:
        self._state = State.DISARMED

    def tell(self, rows: NDArray[np.void]) -> None:
        """Print the transitions within `rows`."""
        for row in rows[np.flatnonzero(np.diff(rows["state"], prepend=self._state))]:
            self._state = State(row["state"])
            cause = CAUSE_TEXT[Cause(row["cause"])]
            _say(f"{self._state.name}: {cause} (force {row['force_N']:.2f} N, voltage {row['voltage_V']:.2f} V)")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
