"""The newest stretch of the recorder's files in which a reference was followed, for a check of the model."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.control.states import State
from piezod.errors import ConfigurationError, TemporaryError, system_error_text
from piezod.recorder.recording_files import recording_files
from piezod.recording import Recording
from piezod.recording.formats.sqlite import read_last_blocks
from piezod.recording.hold import HELD_ONE_SAMPLE
from piezod.recording.ticks import GOOD, pair_rows

SHORTEST_S = 20.0  # of a stretch: loops of a tenth of a hertz close twice
SMALLEST_SPAN = 0.2  # of the voltages, as share of the model's input range: less moves the smallest plays only
LONGEST_GAP_S = 5.0  # between two ticks of a stretch: `ExpectedReading` bridges such a gap too
NEWEST_BLOCKS = 50_000  # of a file in which a stretch is looked for: seven hours


def newest_stretch(bench: BenchConfig, range_V: float, longest_s: float) -> Recording:
    """The end of the newest drive that moves the stack.

    Parameters
    ----------
    range_V
        Input range of the model [V].
    longest_s
        Longest duration of the stretch [s].

    Raises
    ------
    ConfigurationError
        The bench has no recorder, or its folder cannot be read.
    TemporaryError
        The files hold no such stretch.
    """
    folder = bench.recordings_path
    if folder is None:
        raise ConfigurationError(f"{bench.name}: recorder is null, must be a section: no ticks are recorded")
    try:
        files = recording_files(folder, bench.name)
    except OSError as error:
        raise ConfigurationError(f"{folder}: {system_error_text(error)}") from error
    for path in reversed(files):
        stretch = _newest_of(path, bench, SMALLEST_SPAN * range_V, longest_s)
        if stretch is not None:
            return stretch
    raise TemporaryError(
        f"{folder}: no drive of {SHORTEST_S:g} s over {SMALLEST_SPAN * range_V:.3g} V is recorded; drive the bench, "
        "then check again"
    )


def _newest_of(path: Path, bench: BenchConfig, span_V: float, longest_s: float) -> Recording | None:
    """Newest stretch of a file; None without one."""
    most = round(longest_s * bench.rate_Hz)
    parts: list[NDArray[np.void]] = []
    to_wall_ns = 0
    for block in read_last_blocks(path, NEWEST_BLOCKS):
        for rows in reversed(_running_parts(block.rows, bench)):
            if parts and not _follows(rows[-1], parts[-1][0], bench):
                found = _recording(parts, most, bench, span_V, to_wall_ns, path)
                if found is not None:
                    return found
                parts = []
            if not parts:
                to_wall_ns = block.wall_ns - block.clock_ns
            parts.append(rows)
        if sum(part.size for part in parts) > most:
            found = _recording(parts, most, bench, span_V, to_wall_ns, path)
            if found is not None:
                return found
            parts = parts[-1:]
    return _recording(parts, most, bench, span_V, to_wall_ns, path) if parts else None


def _running_parts(rows: NDArray[np.void], bench: BenchConfig) -> list[NDArray[np.void]]:
    """Consecutive rows that follow a reference, without a long gap, oldest first."""
    running = rows["state"] == State.RUNNING
    gaps = np.diff(rows["tick"]) * bench.dt_s > LONGEST_GAP_S
    ends = np.flatnonzero((np.diff(running.astype(np.int8)) != 0) | gaps) + 1
    return [part for part in np.split(rows, ends) if part.size and part["state"][0] == State.RUNNING]


def _follows(last: np.void, first: np.void, bench: BenchConfig) -> bool:
    return (
        0 < int(first["tick"]) - int(last["tick"]) <= LONGEST_GAP_S / bench.dt_s and first["segment"] == last["segment"]
    )


def _recording(
    parts: list[NDArray[np.void]], most: int, bench: BenchConfig, span_V: float, to_wall_ns: int, path: Path
) -> Recording | None:
    """Recording of the last ticks of these parts, newest first; None if it is too short or does not move the stack."""
    commands, readings = pair_rows(np.concatenate(parts[::-1])[-most:])
    good = readings["result"] == GOOD
    commands, readings = commands[good], readings[good]
    if readings.size < SHORTEST_S * bench.rate_Hz or np.ptp(commands["voltage_V"]) < span_V:
        return None
    columns = {"voltage_V": commands["voltage_V"], "force_N": readings["force_N"]}
    if np.isfinite(readings["temperature_C"]).all():
        columns["temperature_C"] = readings["temperature_C"]
    time_s = readings["tick"] * bench.dt_s
    recorded = datetime.fromtimestamp((int(readings["time_ns"][-1]) + to_wall_ns) * 1e-9, UTC)
    metadata = {"bench": bench.name, "file": path.name, "recorded": recorded.isoformat(timespec="seconds")}
    return Recording(time_s - time_s[0], columns, metadata | HELD_ONE_SAMPLE.metadata)
