"""`piezod record`: drive an excitation through the bench and record voltage and force."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.control.references.file_times import check_gaps, tick_positions
from piezod.daemon.run import drive
from piezod.errors import RecordingError, UsageError
from piezod.excitation import EXCITATIONS, duration_s, excitation
from piezod.recording import TIME, Recording, read_recording
from piezod.recording.files import READ_ONLY, SPREADSHEETS
from piezod.recording.formats.strict_csv import StrictTable, read_strict_csv
from piezod.session.assembly import load_bench_without_model
from piezod.session.history import OnRows
from piezod.session.task import Outcome, SegmentSpec

VOLTAGE = "voltage_V"  # column of a recording that is driven again


def record_excitation(
    path: Path,
    name: str,
    *,
    peak_V: float | None,
    frequency_Hz: float,
    periods: int,
    reset_cycle: bool,
    on_rows: OnRows,
) -> tuple[Recording, Outcome]:
    """Drive one excitation and record it.

    Parameters
    ----------
    path
        Bench configuration.
    name
        Name among `EXCITATIONS`, or path of a recording, whose `voltage_V` is interpolated to the ticks and driven.
    peak_V
        Highest voltage [V]; None: `limits.voltage_max_V`, or the voltages of the recording unscaled.
    frequency_Hz
        Frequency of one triangle [Hz].
    periods
        Number of triangles, or of repetitions of the recording.
    reset_cycle
        Whether to drive 0 -> voltage_max_V -> 0 first.
    on_rows
        Called about ten times per second with new rows.

    Returns
    -------
    tuple
        Recording, and outcome of the session. After a fault or a stop the recording has the driven part.

    Raises
    ------
    UsageError
        There is no such excitation, or voltages exceed the limits.
    RecordingError
        The recording to drive cannot be read.
    """
    bench = load_bench_without_model(path)
    voltages_V = _voltages(name, peak_V, frequency_Hz, periods, bench)
    peak_V = float(voltages_V.max())
    segment = SegmentSpec(name, "direct", voltages_V=voltages_V, reset_cycle=reset_cycle)
    history, outcome = drive(path, bench, None, [segment], on_rows)
    metadata = {
        "bench": bench.name,
        "excitation": _description(name, peak_V, frequency_Hz, periods),
        "rate_Hz": f"{bench.rate_Hz:g}",
        "recorded": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    recording = history.recording(0, metadata=metadata, follows_force=False)
    if outcome.fault or outcome.stopped:
        planned_s = voltages_V.size / bench.rate_Hz
        why = outcome.fault or "stopped by the user"
        recording.metadata["incomplete"] = f"{why}, after {_end_s(recording):.1f} of {planned_s:.1f} s"
    return recording, outcome


def excitation_duration_s(name: str, frequency_Hz: float, periods: int) -> float:
    """Duration of an excitation, or of a recording that is driven again [s].

    Parameters
    ----------
    name, frequency_Hz, periods
        As in `record_excitation`.

    Raises
    ------
    UsageError, RecordingError
        There is no such excitation, or the recording cannot be read.
    """
    if name in EXCITATIONS:
        return duration_s(name, frequency_Hz, periods)
    return periods * float(np.ptp(_read_source(name).time_s))


def _voltages(
    name: str, peak_V: float | None, frequency_Hz: float, periods: int, bench: BenchConfig
) -> NDArray[np.float64]:
    """Voltages to drive, one per tick, shape (N,) [V]."""
    if name in EXCITATIONS:
        highest_V = bench.limits.voltage_max_V if peak_V is None else peak_V
        _check_peak(highest_V, bench)
        return excitation(name, highest_V, frequency_Hz, periods, bench.rate_Hz)
    source = _read_source(name)
    positions = tick_positions(source.time_s, bench.rate_Hz, source.time_unit_s)
    ticks = np.arange(int(positions[-1]) + 1, dtype=np.float64)
    voltages_V = np.tile(np.interp(ticks, positions, source.column(VOLTAGE)), periods)
    if peak_V is not None:
        _check_peak(peak_V, bench)
        voltages_V *= peak_V / max(float(voltages_V.max()), 1e-9)
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    if not (low <= voltages_V.min() and voltages_V.max() <= high):
        raise UsageError(
            f"--excitation is {name}: its {VOLTAGE} goes from {voltages_V.min():g} to {voltages_V.max():g}, must stay "
            f"within {low:g} and {high:g} V (limits); --peak scales it"
        )
    return voltages_V


def _end_s(recording: Recording) -> float:
    """Time of the last sample [s]; 0 without samples."""
    return float(recording.time_s[-1]) if recording.time_s.size else 0.0


def _description(name: str, peak_V: float, frequency_Hz: float, periods: int) -> str:
    speed = f", {frequency_Hz:g} Hz" if name in EXCITATIONS else ""
    return f"{name}, peak {peak_V:g} V{speed}, {periods} periods"


def _read_source(name: str) -> StrictTable:
    """Read the recording to drive, strictly: nothing is repaired, and a gap is refused."""
    path = Path(name)
    if not path.suffix:
        raise UsageError(f"--excitation is '{name}', must be one of {', '.join(EXCITATIONS)}, or a recording")
    if path.suffix.lower() in (*READ_ONLY, *SPREADSHEETS):
        raise UsageError(
            f"--excitation is {name}, must be a format that piezod writes: piezod convert {name} -o drive.csv"
        )
    source = read_strict_csv(path) if path.suffix.lower() == ".csv" else _as_table(read_recording(path), path)
    check_gaps(source, None)
    return source


def _as_table(recording: Recording, path: Path) -> StrictTable:
    """Time and voltage of a binary file; its rows count as lines."""
    voltage_V = recording.channel(VOLTAGE)
    bad = np.flatnonzero(~np.isfinite(voltage_V))
    if bad.size:
        raise RecordingError(f"{path}: sample {bad[0]}: {VOLTAGE} is missing, must be a number in a file that drives")
    if notes := [recording.metadata[key] for key in ("time", "damaged") if key in recording.metadata]:
        raise RecordingError(f"{path}: {notes[0]}; a file that drives must need no repair")
    values = np.column_stack([recording.time_s, voltage_V])
    return StrictTable(path, (TIME, VOLTAGE), values, np.arange(voltage_V.size) + 1, 0.0)


def _check_peak(peak_V: float, bench: BenchConfig) -> None:
    low, high = bench.limits.voltage_min_V, bench.limits.voltage_max_V
    if not max(low, 0.0) < peak_V <= high:
        raise UsageError(f"--peak is {peak_V:g} V, must be above {max(low, 0.0):g} and at most {high:g} V (limits)")
