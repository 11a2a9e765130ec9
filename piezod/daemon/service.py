"""`piezod run`: the bench in the foreground. The control process drives; this one says what happens."""

import signal
import sys
from pathlib import Path
from types import FrameType

import numpy as np
from numpy.typing import NDArray

from piezod.control import CAUSE_TEXT, Cause, State
from piezod.daemon.assembly import Work, load
from piezod.daemon.session import Session


def run_foreground(path: Path, *, arm: bool) -> int:
    """Run a bench until its reference ends, a fault latches, or a signal asks for a ramp down.

    Parameters
    ----------
    path
        Bench configuration.
    arm
        Drive; else only read until stopped.

    Returns
    -------
    int
        Exit code: 0, or 1 after a fault.
    """
    bench, model = load(path)
    works = [Work("bench reference", bench.compensation, reset_cycle=bench.arming.reset_cycle)] if arm else []
    session = Session(bench, model, path.parent, works)

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001  # the signature signal handlers have
        session.stop()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    teller = _Teller()
    try:
        session.start()
        _say(f"{bench.name}: {bench.rate_Hz:g} Hz, {'armed' if arm else 'reading only; --arm to drive'}")
        for rows in session.follow():
            teller.tell(rows)
    finally:
        session.close()
    outcome = session.outcome
    for warning in outcome.warnings:
        _say(f"warning: {warning}")
    _say(
        f"{outcome.ticks} ticks, {outcome.missed} missed, {outcome.failed_exchanges} failed exchanges {outcome.results or ''}"
    )
    if outcome.fault:
        _say(f"FAULT: {outcome.fault}")
    return 1 if outcome.fault else 0


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
