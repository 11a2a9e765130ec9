"""Drive an excitation through the bench and keep what it answers."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.commissioning.demo import OnRows, follow_session
from piezod.config import BenchConfig
from piezod.errors import CheckFailedError, UsageError
from piezod.excitation import EXCITATIONS, duration_s, excitation
from piezod.recording import Recording, read_recording
from piezod.session.assembly import Work, load_without_model
from piezod.session.session import Outcome, Session

DRIVEN = "voltage_V"  # the column of a recording that is driven again


def record(
    path: Path,
    name: str,
    *,
    peak_V: float | None,
    frequency_Hz: float,
    periods: int,
    reset_cycle: bool,
    on_rows: OnRows,
) -> tuple[Recording, Outcome]:
    """Record one excitation.

    Parameters
    ----------
    path
        Bench configuration.
    name
        One of `EXCITATIONS`, or the path of a recording whose `voltage_V` is driven, interpolated to the tick.
    peak_V
        Highest voltage; None: the limit's, or a recording's own [V].
    frequency_Hz
        Of one triangle [Hz].
    periods
        Triangles, or repeats of the recording.
    reset_cycle
        Drive 0 -> voltage_max_V -> 0 first.
    on_rows
        Called about ten times a second with what is new.

    Raises
    ------
    UsageError
        No such excitation, or voltages outside the limits.
    RecordingError
        The recording that is to be driven cannot be read.
    CheckFailedError
        A fault ended the recording before its end.
    """
    bench = load_without_model(path)
    voltages_V = _voltages(name, peak_V, frequency_Hz, periods, bench)
    peak_V = float(voltages_V.max())
    work = Work(name, "direct", voltages_V=voltages_V, reset_cycle=reset_cycle)
    session = Session(bench, None, path.parent, [work])
    history = follow_session(session, on_rows)
    if session.outcome.fault:
        raise CheckFailedError(f"the recording ended early: {session.outcome.fault}")
    metadata = {
        "bench": bench.name,
        "excitation": _words(name, peak_V, frequency_Hz, periods),
        "rate_Hz": f"{bench.rate_Hz:g}",
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return history.recording(0, metadata=metadata, follows_force=False), session.outcome


def excitation_s(name: str, frequency_Hz: float, periods: int) -> float:
    """How long the excitation, or the recording that is driven again, lasts [s].

    Raises
    ------
    UsageError, RecordingError
        There is none of that name.
    """
    if name in EXCITATIONS:
        return duration_s(name, frequency_Hz, periods)
    return periods * float(np.ptp(_again(name).time_s))


def _voltages(
    name: str, peak_V: float | None, frequency_Hz: float, periods: int, bench: BenchConfig
) -> NDArray[np.float64]:
    """One voltage a tick [V]."""
    if name in EXCITATIONS:
        highest_V = bench.limits.voltage_max_V if peak_V is None else peak_V
        _check_peak(highest_V, bench)
        return excitation(name, highest_V, frequency_Hz, periods, bench.rate_Hz)
    recording = _again(name)
    time_s = recording.time_s - recording.time_s[0]
    ticks_s = np.arange(round(float(time_s[-1]) * bench.rate_Hz) + 1) / bench.rate_Hz
    voltages_V = np.tile(np.interp(ticks_s, time_s, recording.channel(DRIVEN)), periods)
    if peak_V is not None:
        _check_peak(peak_V, bench)
        voltages_V *= peak_V / max(float(voltages_V.max()), 1e-9)
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    if not (low <= voltages_V.min() and voltages_V.max() <= high):
        raise UsageError(
            f"--excitation is {name}: its {DRIVEN} goes from {voltages_V.min():g} to {voltages_V.max():g}, must stay "
            f"within {low:g} and {high:g} V (limits); --peak scales it"
        )
    return voltages_V


def _words(name: str, peak_V: float, frequency_Hz: float, periods: int) -> str:
    speed = f", {frequency_Hz:g} Hz" if name in EXCITATIONS else ""
    return f"{name}, peak {peak_V:g} V{speed}, {periods} periods"


def _again(name: str) -> Recording:
    """The recording that is to be driven again."""
    if not Path(name).suffix:
        raise UsageError(f"--excitation is '{name}', must be one of {', '.join(EXCITATIONS)}, or a recording")
    return read_recording(Path(name))


def _check_peak(peak_V: float, bench: BenchConfig) -> None:
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    if not max(low, 0.0) < peak_V <= high:
        raise UsageError(f"--peak is {peak_V:g} V, must be above {max(low, 0.0):g} and at most {high:g} V (limits)")
