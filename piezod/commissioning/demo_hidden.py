"""The second half of the demo: a bench that hides creep, lag and delay, recorded, and followed with two models.

It runs in the emulator's own virtual time, one tick a write, so that half a minute of bench takes seconds.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.commissioning.demo import OnRows, follow_session
from piezod.commissioning.emulator import VIRTUAL_RATE_HZ, emulated_bench_file
from piezod.config import load_bench
from piezod.config.reference import WaveformReference
from piezod.errors import CheckFailedError
from piezod.excitation import IDENTIFICATION, excitation
from piezod.model import Model
from piezod.recording import Recording
from piezod.session.assembly import Work
from piezod.session.session import Session

HIDDEN = ("creep", "electrical_lag", "transport_delay")  # each at its default strength
REFERENCE = "multisine, hidden effects"
FOLLOWED = WaveformReference(kind="multisine", amplitude_N=110, offset_N=150, frequency_Hz=0.25, duration_s=8.0)
PEAK_V = 130.0
HOLDS_V, HOLD_S = (100.0, 40.0), 4.0  # creep shows in them
TRIANGLES_HZ, TRIANGLES = 4.0, 8  # and the lag in these
MAIN_HZ = 2.0


def work_V(rate_Hz: float) -> NDArray[np.float64]:
    """Voltages that tell creep, lag and delay apart, one a tick [V]: loops of all sizes, holds, fast triangles."""
    loops = excitation(IDENTIFICATION, PEAK_V, MAIN_HZ, 1, rate_Hz)
    holds = np.repeat([*HOLDS_V, 0.0], round(HOLD_S * rate_Hz))
    fast = excitation("constant-triangles", PEAK_V, TRIANGLES_HZ, TRIANGLES, rate_Hz)
    return np.concatenate((np.zeros(round(0.2 * rate_Hz)), loops, holds, fast))


def record_hidden(folder: Path, on_rows: OnRows) -> Recording:
    """Drive the work through a bench with the hidden effects and keep what it answers.

    Raises
    ------
    CheckFailedError
        A fault ended it.
    """
    with emulated_bench_file(folder, "stack", HIDDEN) as path:
        bench = load_bench(path)
        session = Session(
            bench, None, folder, [Work("work", "direct", voltages_V=work_V(VIRTUAL_RATE_HZ), reset_cycle=False)]
        )
        history = follow_session(session, on_rows)
    if session.outcome.fault:
        raise CheckFailedError(f"the recording ended early: {session.outcome.fault}")
    return history.recording(0, metadata={"bench": bench.name, "hidden": "not told"}, follows_force=False)


def follow_hidden(folder: Path, static: Model, extended: Model, on_rows: OnRows) -> dict[tuple[str, str], Recording]:
    """One reference with plain gain and both models, by (reference, compensation), each on a bench just switched on.

    Raises
    ------
    CheckFailedError
        A fault ended it.
    """
    recordings = {}
    for compensation, kind, model in (
        ("gain", "gain", static),
        ("inverse", "inverse", static),
        ("extended", "inverse", extended),
    ):
        with emulated_bench_file(folder, "stack", HIDDEN) as path:
            bench = load_bench(path)
            session = Session(bench, model, folder, [Work(compensation, kind, FOLLOWED)])
            history = follow_session(session, on_rows)
        if session.outcome.fault or session.outcome.stopped:
            raise CheckFailedError(f"{compensation}: ended early: {session.outcome.fault or 'stopped'}")
        metadata = {"bench": bench.name, "reference": REFERENCE, "compensation": compensation}
        recordings[REFERENCE, compensation] = history.recording(0, metadata=metadata)
    return recordings
