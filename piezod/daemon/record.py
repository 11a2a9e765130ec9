"""Drive an excitation through the bench and keep what it answers."""

from datetime import UTC, datetime
from pathlib import Path

from piezod.config import BenchConfig
from piezod.daemon.assembly import Work, load_without_model
from piezod.daemon.demo import OnRows, follow_session
from piezod.daemon.session import Outcome, Session
from piezod.errors import CheckFailedError, UsageError
from piezod.excitation import EXCITATIONS, excitation
from piezod.recording import Recording


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
        One of `EXCITATIONS`.
    peak_V
        Highest voltage; None: the limit's [V].
    frequency_Hz
        Of one triangle [Hz].
    periods
        Triangles.
    reset_cycle
        Drive 0 -> voltage_max_V -> 0 first.
    on_rows
        Called about ten times a second with what is new.

    Raises
    ------
    UsageError
        No such excitation, or a peak outside the limits.
    CheckFailedError
        A fault ended the recording before its end.
    """
    bench = load_without_model(path)
    peak_V = bench.limits.voltage_max_V if peak_V is None else peak_V
    _check(name, peak_V, bench)
    voltages_V = excitation(name, peak_V, frequency_Hz, periods, bench.rate_Hz)
    work = Work(name, "direct", voltages_V=voltages_V, reset_cycle=reset_cycle)
    session = Session(bench, None, path.parent, [work])
    history = follow_session(session, on_rows)
    if session.outcome.fault:
        raise CheckFailedError(f"the recording ended early: {session.outcome.fault}")
    metadata = {
        "bench": bench.name,
        "excitation": f"{name}, peak {peak_V:g} V, {frequency_Hz:g} Hz, {periods} periods",
        "rate_Hz": f"{bench.rate_Hz:g}",
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    return history.recording(0, metadata=metadata, follows_force=False), session.outcome


def _check(name: str, peak_V: float, bench: BenchConfig) -> None:
    if name not in EXCITATIONS:
        raise UsageError(f"--excitation is '{name}', must be one of {', '.join(EXCITATIONS)}")
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    if not max(low, 0.0) < peak_V <= high:
        raise UsageError(f"--peak is {peak_V:g} V, must be above {max(low, 0.0):g} and at most {high:g} V (limits)")
