"""Columns of a file with named vectors: which are read, under which names, and which of them is the time.

HDF5, MAT, Parquet, TDMS and MDF files hold vectors with a path and perhaps a unit. A file with several tables, with
columns without a name, or without a time that is one, is refused with the option that says it.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording.formats.stream import RecordingStream, Table, common_length, skipped_parts
from piezod.recording.formats.text_head import chosen_columns, is_serial_day, unit_since_1970
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME, channel_name, name_columns
from piezod.recording.quantities import UNITS, column_of

Raw = dict[str, NDArray[Any]]
Pieces = Callable[[Sequence[str], int], Iterator[Raw]]
"""Function of (paths, number of samples): yields the stored numbers or dates by path, in the order of time."""

LOOKED_AT = 1000  # samples of a time without a unit that decide about its unit
MOST_LISTED = 300  # characters of a list of columns in a message


class Stored(NamedTuple):
    """A vector of a file.

    Parameters
    ----------
    path
        Its only name in the file, such as `run1/force`.
    samples
        Its length.
    unit
        Its unit; empty: none is stored.
    name
        Its own name, such as `force`.
    is_date
        Whether it holds dates.
    of_matrix
        Whether it is a column of a matrix; such a column is never the time, unless the user names it.
    timing
        Start and interval of its samples as the file states them, such as `t0 = 0.5`; empty: none is stated.
    """

    path: str
    samples: int
    unit: str = ""
    name: str = ""
    is_date: bool = False
    of_matrix: bool = False
    timing: str = ""

    @property
    def table(self) -> str:
        """Path of the group or struct that holds it."""
        return self.path.rpartition("/")[0]

    @property
    def is_time(self) -> bool:
        """Whether it is the time by its name, dates or unit."""
        return not self.of_matrix and (
            self.is_date
            or " since " in self.unit
            or TIME in (channel_name(self.name), channel_name(self.name, self.unit))
            or column_of(self.name, self.unit).quantity == "time"
        )


class Time(NamedTuple):
    """Time of a file: path of its column (empty: evenly spaced), factor to seconds, whether its first value is 0."""

    path: str
    factor: float
    since_first: bool = False


def named_stream(
    path: Path,
    every: Sequence[Stored],
    pieces: Pieces,
    metadata: dict[str, str],
    options: TextOptions,
    even_time: Callable[[NDArray[np.int64]], Array] | None = None,
) -> RecordingStream:
    """Stream of the columns that are wanted, with their time.

    Parameters
    ----------
    every
        Vectors of numbers or dates in the file.
    metadata
        Keys and values of the file's own description; lines on what was understood are added.
    even_time
        Function from sample numbers to times [s], where the file states a sample interval; None: it does not.

    Raises
    ------
    RecordingError
        The file has no time, or a question that only the user can answer; the message names the option.
    """
    if options.rate_Hz:
        period_s = 1.0 / options.rate_Hz
        even_time = lambda rows: np.asarray(period_s * rows, dtype=np.float64)  # noqa: E731  # as the caller's
        metadata["understood"] = f"time from a sample interval of {period_s:.9g} s"
    columns = _wanted(path, every, options)
    _check_timing(path, columns, metadata)
    _name_left_out(every, columns, metadata)
    time, names = _time_of(path, columns, pieces, metadata, even=even_time is not None)
    samples = common_length(path, {name: column.samples for name, column in columns.items()})
    stored = {name: columns[written].path for name, written in names.items()}

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        first: Any = None
        done = 0
        for raw in pieces([stored[name] for name in wanted if name in stored], chunk):
            table = {name: _numbers(raw[stored[name]]) for name in wanted if name != TIME}
            if time.path:
                first = raw[time.path][0] if first is None and raw[time.path].size else first
                table[TIME] = _seconds(raw[time.path], time, first)
            else:
                size = next(iter(raw.values())).shape[0]
                table[TIME] = np.asarray(even_time(np.arange(done, done + size)) if even_time else [])
                done += size
            yield table

    return RecordingStream(path, (*([] if TIME in names else [TIME]), *names), chunks, samples, metadata)


def _numbers(values: NDArray[Any]) -> Array:
    return np.ascontiguousarray(values, dtype=np.float64)


def _seconds(values: NDArray[Any], time: Time, first: Any) -> Array:  # noqa: ANN401
    """Times [s]; dates and times since 1970 are subtracted as whole numbers, before they are rounded."""
    if values.dtype.kind == "M":
        steps = (values - first).astype("timedelta64[ns]")
        return np.where(np.isnat(steps), np.nan, 1e-9 * steps.astype(np.int64))
    since = values - first if time.since_first else values
    with np.errstate(over="ignore"):  # a damaged time is refused where it is checked
        return _numbers(since) if time.factor == 1.0 else np.round(time.factor * _numbers(since), 12)


def _wanted(path: Path, every: Sequence[Stored], options: TextOptions) -> dict[str, Stored]:
    """Columns that are read, by their name in the recording."""
    by_path = {column.path: column for column in every}
    chosen = chosen_columns(options.columns)
    unnamed = [column for column in every if column.of_matrix]
    if options.columns and not chosen:
        if len(options.columns) == len(unnamed) and not set(options.columns) <= set(by_path):
            return dict(zip(options.columns, unnamed, strict=True))
        chosen = {entry: entry for entry in options.columns}
    if chosen:
        absent = next((written for written in chosen.values() if written not in by_path), None)
        if absent is not None:
            raise RecordingError(f"{path}: --columns names '{absent}', the file has {_listed(every)}")
        return {
            by_path[written].name if name == written else name: by_path[written] for name, written in chosen.items()
        }
    return _by_name(_one_table(path, every))


def _check_timing(path: Path, columns: Mapping[str, Stored], metadata: dict[str, str]) -> None:
    """Refuse columns whose samples are at different times by the file's own words; name words that only some have."""
    stated = {column.timing: column.path for column in columns.values() if column.timing}
    listed = ", ".join(f"{written} of {timing}" for timing, written in stated.items())[:MOST_LISTED]
    if len(stated) > 1:
        raise RecordingError(f"{path}: columns differ in time: {listed}; export columns of one time")
    if stated and any(not column.timing and not _is_time(key, column) for key, column in columns.items()):
        notes = filter(None, [metadata.get("attributes"), f"times that are not applied: {listed}"])
        metadata["attributes"] = "; ".join(notes)


def _name_left_out(every: Sequence[Stored], columns: Mapping[str, Stored], metadata: dict[str, str]) -> None:
    used = set(columns.values())
    left_out = dict.fromkeys(column.path.partition(":")[0] for column in every if column not in used)
    if left_out:
        metadata |= skipped_parts([*filter(None, [metadata.get("skipped")]), *left_out])


def _by_name(columns: Sequence[Stored]) -> dict[str, Stored]:
    """The columns by their own name, or by their path if another column has this name."""
    count = Counter(column.name for column in columns)
    return {column.name if count[column.name] == 1 else column.path: column for column in columns}


def _one_table(path: Path, every: Sequence[Stored]) -> list[Stored]:
    """The named columns; in a file of several tables, the only table with a time."""
    named = [column for column in every if not column.of_matrix]
    if not named and every:
        raise RecordingError(
            f"{path}: has no named columns, has {_listed(every)}; name them with --columns time_s,voltage_V,force_N"
        )
    times = [column for column in named if column.is_time]
    of_time = {time.path: [column for column in every if _belongs(column, time)] for time in times}
    tables = {time.table: of_time[time.path] for time in times if set(of_time[time.path]) - set(times)}
    if len(tables) > 1:
        raise RecordingError(
            f"{path}: holds several tables, {_listed(named)}; choose the columns with --columns NAME=PATH, such as "
            f"time_s={times[0].path},voltage_V=..."
        )
    return next(iter(tables.values()), named)


def _belongs(column: Stored, time: Stored) -> bool:
    """Whether a column has the length of a time and is stored next to it or below it."""
    return column.samples == time.samples and f"{column.table}/".startswith(f"{time.table}/" if time.table else "")


def _time_of(
    path: Path, columns: Mapping[str, Stored], pieces: Pieces, metadata: dict[str, str], *, even: bool
) -> tuple[Time, dict[str, str]]:
    """The time, and the name of each channel with the key of its column."""
    exact = [key for key, column in columns.items() if TIME in (channel_name(key), channel_name(key, column.unit))]
    times = exact or [key for key, column in columns.items() if _is_time(key, column)]
    if even:
        names = name_columns(path, [*((key, columns[key].unit) for key in columns if key not in times), (TIME, "")])
        return Time("", 1.0), dict(zip(names, [key for key in columns if key not in times], strict=False))
    if len(times) > 1:
        listed = ", ".join(columns[key].path for key in times)
        raise RecordingError(f"{path}: {listed} all look like time; choose the columns with --columns NAME=PATH")
    if not times:
        present = ", ".join(channel_name(key, column.unit) for key, column in columns.items())
        skipped = metadata.get("skipped", "")
        remedy = "say which with --columns time_s=NAME,..., or give --rate-Hz"
        if not columns and skipped:
            remedy = f"left out is {skipped[:120]}; store each column as a vector of numbers, or export .csv"
        raise RecordingError(f"{path}: has no {TIME}, has {present[:200] or 'no columns of numbers'}; {remedy}")
    time = _unit_of(path, times[0], columns[times[0]], pieces, metadata)
    names = name_columns(path, [(TIME, "") if key in times else (key, columns[key].unit) for key in columns])
    return time, dict(zip(names, columns, strict=True))


def _is_time(key: str, column: Stored) -> bool:
    return column.is_date or column._replace(name=key).is_time


def _unit_of(path: Path, key: str, column: Stored, pieces: Pieces, metadata: dict[str, str]) -> Time:
    """Unit of a column of time: as stored or named, of dates, or by its size."""
    if column.is_date:
        metadata["understood"] = f"time as dates from '{column.path}'"
        return Time(column.path, 1.0)
    if channel_name(key) == TIME and not column.unit:
        return Time(column.path, 1.0)
    unit = column_of(key, column.unit.partition(" since ")[0]).unit
    since_first = " since " in column.unit
    if not unit and column.unit:
        raise RecordingError(
            f"{path}: {column.path} is in {column.unit!r:.40}, must be one of {' '.join(UNITS['time'])}; say it with "
            f"--columns time_ms={column.path},..., or give --rate-Hz"
        )
    if not unit:
        values = next(pieces([column.path], LOOKED_AT))[column.path][:LOOKED_AT]
        if values.size and (values == np.rint(values)).all():
            unit = unit_since_1970([int(value) for value in values])
            since_first = bool(unit)
        elif not is_serial_day([str(value) for value in values[[0, -1]]]):
            unit = "s"
        if not unit:
            raise RecordingError(
                f"{path}: {column.path} is {values[:1]} without unit, may be s, ms, days or a count; say it with "
                f"--columns time_ms={column.path},..., or give --rate-Hz"
            )
    if channel_name(key, column.unit) != TIME:
        metadata["understood"] = (
            f"time in {unit} from '{column.path}'{', since its first value' if since_first else ''}"
        )
    return Time(column.path, UNITS["time"][unit], since_first)


def _listed(columns: Sequence[Stored]) -> str:
    text = ", ".join(f"{column.path} ({column.samples})" for column in columns)
    return text if len(text) <= MOST_LISTED else f"{text[:MOST_LISTED]} ..."
