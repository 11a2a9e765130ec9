"""Read recordings for identification and simulation, and make them fit for use.

A file is read once, in pieces: only the requested columns must fit in memory. Nothing is resampled. The model is
independent of the rate, and interpolation would lower the noise with which errors are compared.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piezod.arrays import Array
from piezod.errors import RecordingError, UsageError
from piezod.estimation.recordings.layout import entry_of
from piezod.estimation.recordings.quality import describe_missing, describe_stuck, describe_timing
from piezod.estimation.recordings.strays import LARGEST, without_strays
from piezod.estimation.recordings.stuck import find_stuck
from piezod.estimation.recordings.suitability import FEWEST_SAMPLES
from piezod.model import file_sha256
from piezod.model.parameters import RecordingSource
from piezod.recording import TIME, Recording, TextOptions, column_names, open_stream
from piezod.recording.conversion import factor_to, stored_column
from piezod.recording.formats.access import library_errors
from piezod.recording.formats.repairs import repair_notes
from piezod.recording.formats.stream import GrowingColumn
from piezod.recording.stretches import gaps

OnStep = Callable[[str, float | None], None]

CHUNK = 2**20  # samples read at once
TEMPERATURES = ("temperature_C", "temperature_degC")
"""Names of temperature columns [degree Celsius]; the recording gets the first name."""

UNSEEN = 0.01  # share of its swing that the input may move while samples are missing
FASTEST = 0.99  # quantile of the slew rates that stands for the input's fastest one
MOST_STUCK = 0.5  # share of the output's samples that may be frozen or clipped


@dataclass(frozen=True)
class LoadedRecording:
    """A recording that is fit for identification or simulation.

    Parameters
    ----------
    recording
        Input, output, temperature where the file has it, and further columns that were requested. Every input sample is
        a number. An output sample that is missing, frozen or clipped is nan.
    sha256
        Hash of the file's bytes, as hexadecimal text.
    notes
        One line for each property of the file that matters and for each change made to its samples.
    text
        Layout of the text file as the user states it; None: not stated.
    """

    recording: Recording
    sha256: str
    notes: list[str]
    text: TextOptions | None = None

    @property
    def source(self) -> RecordingSource:
        """Entry for the provenance of a model."""
        return entry_of(self.recording, self.sha256, self.text)


def load_recordings(
    paths: Sequence[Path],
    input_column: str,
    output_column: str,
    on_step: OnStep = lambda *_: None,
    text: TextOptions | None = None,
) -> list[LoadedRecording]:
    """Read recordings for identification.

    A recording with a long hole in its input is reduced to its longest stretch without one. Output samples that are
    frozen or clipped become nan.

    Parameters
    ----------
    input_column, output_column
        Column names, such as `voltage_V`; a file may hold the column in another multiple of its unit, `voltage_kV`.
    on_step
        Called repeatedly with the current step in words, and None because the share done is unknown.
    text
        Layout of text files as the user states it; None: inferred from the files.

    Raises
    ------
    RecordingError
        A file cannot be read, lacks a column, or most of its output is frozen or clipped.
    UsageError
        Input and output are the same column.
    """
    if input_column == output_column:
        raise UsageError(f"--input and --output are both {input_column}, must be different columns")
    loaded = []
    for path in paths:
        recording, sha256, notes = _read(path, column_names(path, text), [input_column, output_column], on_step, text)
        loaded.append(replace(usable(recording, input_column, output_column, sha256, notes), text=text))
    return loaded


def load_for_simulation(
    path: Path,
    input_column: str,
    output_column: str,
    also: Sequence[str] = (),
    on_step: OnStep = lambda *_: None,
    text: TextOptions | None = None,
) -> LoadedRecording:
    """Read a recording for simulation, with further columns `also`: every row stays, the output may be absent.

    Raises
    ------
    RecordingError
        The file cannot be read, or its input has a hole too long to interpolate.
    """
    names = column_names(path, text)
    wanted = [input_column, *also]
    if any(factor_to(output_column, name) for name in names):
        wanted.append(output_column)
    recording, sha256, notes = _read(path, names, wanted, on_step, text)
    recording, more = fit_for_simulation(recording, input_column, output_column)
    return _loaded(recording, sha256, notes + more)


def fit_for_simulation(recording: Recording, input_column: str, output_column: str) -> tuple[Recording, list[str]]:
    """The recording as simulation needs it, and notes.

    Every row stays, and the output may be absent. The argument is not changed.

    Raises
    ------
    RecordingError
        The input has a hole too long to interpolate.
    """
    recording, strays = without_strays(recording, input_column, output_column)
    bridged, breaks, notes = _bridge(recording, input_column)
    notes = [*strays, *notes]
    bridged = Recording(bridged.time_s, dict(bridged.channels), bridged.metadata, bridged.source)
    u = bridged.channel(input_column)
    if not np.isfinite(u).all():
        line = describe_missing(recording, input_column)[0]
        raise RecordingError(
            f"{recording.source}: {line}; must be there in every row that is simulated, cut the file there"
        )
    notes += [f"{_pause(recording, hole)}: what the input did there is not known" for hole in breaks]
    if output_column in bridged.channels:
        bridged.channels[output_column] = bridged.channel(output_column).copy()
    if output_column in bridged.channels and np.isnan(bridged.channel(output_column)).all():
        notes.append(f"{output_column} holds no number, nothing is compared")
        del bridged.channels[output_column]
    if output_column in bridged.channels:
        notes += _mask(bridged, input_column, output_column, most=1.0)
    return bridged, notes


def usable(
    recording: Recording, input_column: str, output_column: str, sha256: str, notes: Sequence[str] = ()
) -> LoadedRecording:
    """Make a recording fit for identification, as `load_recordings` does; `notes` stand before the new ones.

    Raises
    ------
    RecordingError
        Most of the output is frozen or clipped, or no stretch of the input has 100 samples.
    """
    recording, strays = without_strays(recording, input_column, output_column)
    notes = [*notes, *strays]
    recording, breaks, bridge_notes = _bridge(recording, input_column)
    recording, cut = _longest(recording, input_column, breaks)
    notes += bridge_notes + cut
    notes += [f"{line}; used as they are, the model knows no rate" for line in describe_timing(recording)[:1]]
    notes += _mask(recording, input_column, output_column, most=MOST_STUCK)
    return _loaded(recording, sha256, notes)


def _loaded(recording: Recording, sha256: str, notes: list[str]) -> LoadedRecording:
    return LoadedRecording(recording, sha256, [f"{recording.source}: {note}" for note in notes])


def _read(
    path: Path, names: Sequence[str], wanted: Sequence[str], on_step: OnStep, text: TextOptions | None
) -> tuple[Recording, str, list[str]]:
    """Requested columns and temperature, converted to their units; hash and notes."""
    stored = {column: stored_column(path, names, column) for column in wanted}
    for name in [name for name in TEMPERATURES if name in names][:1]:
        stored[TEMPERATURES[0]] = (name, 1.0)
    with ThreadPoolExecutor(1) as pool, library_errors(path, "read"):
        sha256 = pool.submit(file_sha256, path)  # in parallel: the disk reads the file once
        columns = {name: GrowingColumn() for name in (TIME, *(name for name, _ in stored.values()))}
        metadata: dict[str, str] = {}
        for piece in open_stream(path, list(columns), CHUNK, text):
            columns[TIME].add(piece.time_s)
            for name, values in piece.channels.items():
                columns[name].add(values)
            metadata = piece.metadata  # after the last piece it names the damaged blocks
            on_step(f"reading {path.name}, {1e-6 * columns[TIME].size:.1f} million samples", None)
        if not columns[TIME].size:
            raise RecordingError(f"{path}: has no samples")
        channels = {
            column: _scaled(columns[name].values(), factor, keep=column in wanted)
            for column, (name, factor) in stored.items()
        }
        converted = [f"{column}: is {name} times {by:g}" for column, (name, by) in stored.items() if by != 1.0]
        recording = Recording(columns[TIME].values(), channels, {}, str(path))
        return recording, sha256.result(), file_notes(metadata, converted)


def file_notes(metadata: dict[str, str], converted: Sequence[str]) -> list[str]:
    """Lines on how a file was read, on converted channels, repairs, and damaged blocks."""
    notes = [f"read as: {metadata['understood']}"] if "understood" in metadata else []
    notes += [*converted, *repair_notes(metadata)]
    return notes + ([f"damaged: {metadata['damaged']}"] if "damaged" in metadata else [])


def _scaled(values: Array, factor: float, *, keep: bool) -> Array:
    """Values times a factor. Values beyond any measurement become nan, except with `keep`: they get a note later."""
    if factor != 1.0:
        values = values * factor
    if not keep:
        values[(values > LARGEST) | (values < -LARGEST)] = np.nan
    return values


def _bridge(recording: Recording, column: str) -> tuple[Recording, list[tuple[int, int]], list[str]]:
    """Interpolate the input over short holes; long holes as (last sample before, first sample after), and notes."""
    u, time_s = recording.channel(column), recording.time_s
    absent = np.isnan(u)
    if absent.all():
        raise RecordingError(f"{recording.source}: {column} holds no number at all; record again")
    if not absent.any():
        return recording, _holes(time_s, u), []
    present = np.flatnonzero(~absent)
    holes = [(int(present[k]), int(present[m])) for k, m in _holes(time_s[present], u[present])]
    filled = np.interp(time_s, time_s[present], u[present], left=np.nan, right=np.nan)
    for before, after in holes:
        filled[before + 1 : after] = np.nan
    bridged = np.isfinite(filled) & absent
    notes = describe_missing(recording, column)
    if bridged.any():
        notes[0] += f"; {np.count_nonzero(bridged)} of them interpolated"
    return Recording(time_s, recording.channels | {column: filled}, {}, recording.source), holes, notes


def _holes(time_s: Array, u: Array) -> list[tuple[int, int]]:
    """Pairs of neighbouring samples between which the input may have moved by more than `UNSEEN`."""
    long = gaps(time_s)
    if not long:
        return []
    every = max(1, time_s.size // CHUNK)
    slews = np.abs(u[1::every] - u[:-1:every]) / (time_s[1::every] - time_s[:-1:every])
    fastest, most = np.quantile(slews, FASTEST), UNSEEN * np.ptp(u)
    return [(before, after) for before, after in long if fastest * (time_s[after] - time_s[before]) > most]


def _longest(recording: Recording, column: str, holes: Sequence[tuple[int, int]]) -> tuple[Recording, list[str]]:
    """The longest stretch without a hole in the input, and notes on the rows that are cut."""
    u = recording.channel(column)
    starts = [0, *(after for _, after in holes)]
    stops = [*(before + 1 for before, _ in holes), int(u.size)]
    start, stop = max(zip(starts, stops, strict=True), key=lambda part: part[1] - part[0])
    present = np.isfinite(u[start:stop])
    start, stop = start + int(np.argmax(present)), stop - int(np.argmax(present[::-1]))
    if (start, stop) == (0, u.size):
        return recording, []
    why = f"; {_pause(recording, holes[0])}" if holes else ""
    more = f" and {len(holes) - 1} more" if len(holes) > 1 else ""
    if stop - start < FEWEST_SAMPLES <= u.size:
        raise RecordingError(
            f"{recording.source}: {column} is there for {stop - start} samples at a stretch, must be for "
            f"{FEWEST_SAMPLES}{why}{more}; record without pauses"
        )
    longest = recording.part(slice(start, stop))
    where = f"{longest.time_s[0]:.6g} to {longest.time_s[-1]:.6g} s, {stop - start} of {u.size} samples"
    return longest, [f"{column}: only {where}, are used: the memory cannot be followed where it is missing{why}{more}"]


def _pause(recording: Recording, hole: tuple[int, int]) -> str:
    before, after = hole
    return f"no input from {recording.time_s[before]:.6g} to {recording.time_s[after]:.6g} s"


def _mask(recording: Recording, input_column: str, output_column: str, *, most: float) -> list[str]:
    """Set frozen and clipped output samples to nan; return notes."""
    notes = [f"{line}; not fitted" for line in describe_missing(recording, output_column)]
    y = recording.channel(output_column)
    present = np.count_nonzero(np.isfinite(y))
    stuck = find_stuck(y, recording.channel(input_column))
    lines = describe_stuck(recording, output_column, stuck)
    share = sum(stop - start for start, stop in stuck.stretches) / max(int(present), 1)
    if share > most:
        raise RecordingError(
            f"{recording.source}: {lines[0]}; {100 * share:.0f} % of its samples are frozen or clipped, may be "
            f"{100 * most:.0f} %; give the sensor a larger range, or lower the peak"
        )
    for start, stop in stuck.stretches:
        y[start:stop] = np.nan
    return notes + [f"{line}; not fitted" for line in lines]
