"""Second part of the demo: a bench with hidden creep, lag and delay is recorded, then driven with two models.

The emulator runs in virtual time, one tick per write, so that half a minute of bench time takes a few seconds.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.commissioning.emulator import VIRTUAL_RATE_HZ, virtual_time_bench
from piezod.config import load_bench
from piezod.config.reference import WaveformReference
from piezod.daemon.run import drive
from piezod.errors import CheckFailedError
from piezod.excitation import IDENTIFICATION, excitation
from piezod.model import Model
from piezod.recording import Recording
from piezod.session.history import OnRows
from piezod.session.task import SegmentSpec

HIDDEN = ("creep", "electrical_lag", "transport_delay")  # effects of the emulated bench, each at its default strength
REFERENCE_NAME = "multisine, hidden effects"
REFERENCE = WaveformReference(kind="multisine", amplitude_N=110, offset_N=150, frequency_Hz=0.25, duration_s=8.0)
PEAK_V = 130.0
HOLDS_V, HOLD_S = (100.0, 40.0), 4.0  # constant voltages [V] and their duration [s]; they show creep
TRIANGLES_HZ, TRIANGLES = 4.0, 8  # frequency [Hz] and number of fast triangles; they show the lag
LOOPS_HZ = 2.0


def _excitation_voltages(rate_Hz: float) -> NDArray[np.float64]:
    """Voltages that separate creep, lag and delay, shape (N,) [V]: loops of all sizes, holds, fast triangles."""
    loops = excitation(IDENTIFICATION, PEAK_V, LOOPS_HZ, 1, rate_Hz)
    holds = np.repeat([*HOLDS_V, 0.0], round(HOLD_S * rate_Hz))
    fast = excitation("constant-triangles", PEAK_V, TRIANGLES_HZ, TRIANGLES, rate_Hz)
    return np.concatenate((np.zeros(round(0.2 * rate_Hz)), loops, holds, fast))


def record_hidden_effects(folder: Path, on_rows: OnRows) -> Recording:
    """Drive the excitation through a bench with the hidden effects and record it.

    Parameters
    ----------
    on_rows
        Called about ten times per second with new rows.

    Raises
    ------
    CheckFailedError
        A fault ended the session early.
    """
    with virtual_time_bench(folder, "stack", HIDDEN) as path:
        bench = load_bench(path)
        voltages_V = _excitation_voltages(VIRTUAL_RATE_HZ)
        segment = SegmentSpec("work", "direct", voltages_V=voltages_V, reset_cycle=False)
        history, outcome = drive(path, bench, None, [segment], on_rows, keeps_rows=False)
    if outcome.fault:
        raise CheckFailedError(f"the recording ended early: {outcome.fault}")
    return history.recording(0, metadata={"bench": bench.name, "hidden": "effects"}, follows_force=False)


def compare_models(folder: Path, static: Model, extended: Model, on_rows: OnRows) -> dict[tuple[str, str], Recording]:
    """Follow one reference with plain gain and with both models, each time on a bench that was just switched on.

    Parameters
    ----------
    static, extended
        Model without the hidden effects, and the extended model of the diagnosis.
    on_rows
        Called about ten times per second with new rows.

    Returns
    -------
    dict
        Recordings by (reference, compensation).

    Raises
    ------
    CheckFailedError
        A fault or a stop ended a session early.
    """
    recordings = {}
    for compensation, kind, model in (
        ("gain", "gain", static),
        ("inverse", "inverse", static),
        ("extended", "inverse", extended),
    ):
        with virtual_time_bench(folder, "stack", HIDDEN) as path:
            bench = load_bench(path)
            spec = SegmentSpec(compensation, kind, REFERENCE)
            history, outcome = drive(path, bench, model, [spec], on_rows, keeps_rows=False)
        if outcome.fault or outcome.stopped:
            raise CheckFailedError(f"{compensation}: ended early: {outcome.fault or 'stopped'}")
        metadata = {"bench": bench.name, "reference": REFERENCE_NAME, "compensation": compensation}
        recordings[REFERENCE_NAME, compensation] = history.recording(0, metadata=metadata)
    return recordings
