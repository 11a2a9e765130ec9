"""Layout of delimited text: encoding, separator, decimal mark, preamble, header and units, columns.

A sample from the begin of the file decides. Each pair of separator and decimal mark is tried; the pair under which most
lines are rows of numbers with an equal number of cells is taken. If the cells leave a question open, the file is
refused with the option that does.
"""

import functools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from piezod.errors import RecordingError, UsageError
from piezod.recording.formats.text_cells import (
    COMMENTS,
    day_of,
    is_clock,
    is_grouped,
    is_number,
    is_undecided,
    split_cells,
)
from piezod.recording.formats.text_head import (
    MOST_PREAMBLE_LINES,
    ROW,
    check_names,
    columns_of,
    head_of,
    metadata_of,
    stated_interval_s,
    time_column,
    with_time_unit,
    with_unit,
)
from piezod.recording.quantities import Column

SAMPLE = 2**18
"""Bytes from the begin of the file that decide about its layout."""

SEPARATORS = {"\t": "tab", ";": "semicolon", ",": "comma", "|": "bar", " ": "spaces"}
FEWEST_ROWS = 2
"""Rows of numbers that a table must begin with, so that a line of the preamble is not taken for one."""


@dataclass(frozen=True)
class TextOptions:
    """Layout of a text file as the user states it.

    Parameters
    ----------
    columns
        Names of the columns in their order, such as `time_ms`, `voltage_V`; empty: from the file's header.
    rate_Hz
        Samples per second, for a file without a column of time; None: from the file.
    decimal
        Decimal mark, a point or a comma; empty: from the file.
    """

    columns: tuple[str, ...] = ()
    rate_Hz: float | None = None
    decimal: str = ""

    @classmethod
    def of(cls, columns: str | None, rate_Hz: float | None, decimal: str | None) -> "TextOptions":
        """Options of a command.

        Parameters
        ----------
        columns
            Names with commas between; None: not given.
        rate_Hz, decimal
            As for the class; None: not given.

        Raises
        ------
        UsageError
            A name is empty, or the decimal mark is neither a point nor a comma.
        """
        names = () if columns is None else tuple(name.strip() for name in columns.split(","))
        if not all(names):
            raise UsageError(f"--columns is '{columns}', must be names with commas between")
        if decimal not in (None, ".", ","):
            raise UsageError(f"--decimal is '{decimal}', must be . or ,")
        return cls(names, rate_Hz, decimal or "")


@dataclass(frozen=True)
class Layout:
    """Layout of a text file.

    Parameters
    ----------
    encoding
        Name of the encoding for `bytes.decode`.
    separator, decimal
        Characters between two cells, and before the decimals.
    grouped
        Whether marks group thousands.
    head_lines
        Lines before the first row.
    columns
        Name, quantity and unit of each column.
    time
        Index of the column of time; -1: there is none.
    date_form
        Form of its dates for `datetime.strptime`, empty for times of day; None: it holds numbers.
    first_day
        Ordinal of the first day, where the times have dates.
    interval_s
        Sample interval [s], where the column of time is missing or not used; None: time is read from its column.
    metadata
        Keys and values of the preamble.
    notes
        Assumptions, one line each.
    """

    encoding: str
    separator: str
    decimal: str
    grouped: bool
    head_lines: int
    columns: tuple[Column, ...]
    time: int = -1
    date_form: str | None = None
    first_day: int = 0
    interval_s: float | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def understood(self) -> str:
        """The layout in a line."""
        words = [SEPARATORS[self.separator], f"decimal {'comma' if self.decimal == ',' else 'point'}", self.encoding]
        if self.interval_s is not None:
            words.append(f"time from a sample interval of {self.interval_s:.9g} s")
        else:
            column = self.columns[self.time]
            form = f"as {self.date_form or 'time of day'}" if self.date_form is not None else f"in {column.unit or 's'}"
            words.append(f"time {form} from '{column.written}'")
        others = [column for k, column in enumerate(self.columns) if k != self.time]
        words += [f"{column.channel} from '{column.written}'" for column in others]
        return ", ".join([*words, *self.notes])


def encoding_of(raw: bytes) -> str:
    """Encoding of a text: by its byte order mark, by the zero bytes of UTF-16, UTF-8 where it is valid, else cp1252."""
    if raw.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    zeros = raw[:1024].count(b"\0")
    if zeros > len(raw[:1024]) // 4:
        return "utf-16-le" if raw[1:2] == b"\0" else "utf-16-be"
    try:
        raw[: max(0, len(raw) - 4)].decode("utf-8")
    except UnicodeDecodeError as error:
        if error.end < len(raw) - 8:
            return "cp1252"
    return "utf-8"


def find_layout(path: Path, options: TextOptions) -> Layout:
    """Find the layout of a text file.

    Parameters
    ----------
    options
        Layout as the user states it.

    Raises
    ------
    RecordingError
        It holds no table of numbers, or a question that only the user can answer; the message names the option.
    """
    state = path.stat()
    return _layout_of(path, state.st_mtime_ns, state.st_size, options)


@functools.lru_cache(maxsize=8)  # the names of the columns are wanted before the columns
def _layout_of(path: Path, _changed_ns: int, _size: int, options: TextOptions) -> Layout:
    with path.open("rb") as file:
        raw = file.read(SAMPLE)
    if not raw.strip():
        raise RecordingError(f"{path}: is empty, must hold a header row and samples")
    encoding = encoding_of(raw)
    text = raw.decode(encoding, errors="replace")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if len(raw) == SAMPLE:
        lines.pop()  # perhaps cut
    separator, decimal, first, width = _table(path, lines[: 2 * MOST_PREAMBLE_LINES], options.decimal)
    if separator == ";" and not options.decimal and not any("," in line for line in lines[first:]):
        decimal = "."  # a point is a decimal mark where no comma is
    rows = [cells for line in lines[first:] if len(cells := split_cells(line, separator)) == width]
    _check_decimal(path, rows, separator, decimal, options)
    header, units, above = head_of(lines[:first], separator, width)
    notes: list[str] = []
    columns = columns_of(path, options.columns, header, units, rows, width)
    if columns[0].written == ROW != header[0]:
        notes.append(f"the first column has no name and counts rows, it is called {ROW}")
    time, date_form = time_column(path, columns, rows, decimal)
    interval_s = None
    if options.rate_Hz:
        interval_s, date_form = 1.0 / options.rate_Hz, None
        if time >= 0:
            notes.append(f"'{columns[time].written}' is not used, --rate-Hz is given")
    elif time >= 0:
        columns = with_time_unit(path, columns, time, rows, date_form, notes)
    elif (interval_s := stated_interval_s(lines[:first], decimal)) is None:
        raise RecordingError(
            f"{path}: has no column of time, has {', '.join(column.written for column in columns)[:120]}; "
            "give --rate-Hz, or name the columns with --columns time_s,..."
        )
    columns = tuple(with_unit(column, notes) for column in columns)
    grouped = any(is_grouped(cell, decimal) for cells in rows for cell in cells)
    first_day = day_of(rows[0][time], date_form) if date_form else 0
    check_names(path, columns)
    return Layout(
        encoding,
        separator,
        decimal,
        grouped,
        first,
        columns,
        time,
        date_form,
        first_day,
        interval_s,
        metadata_of(above),
        tuple(notes),
    )


def _table(path: Path, lines: Sequence[str], decimal: str) -> tuple[str, str, int, int]:
    """Separator, decimal mark, number of the first row, and cells of a row."""
    best = (0, 0, "", "", 0)
    for separator in SEPARATORS:
        marks = (",", ".") if separator == ";" else (".", ",")  # the first is taken where both read all rows
        for mark in (decimal,) if decimal else marks:
            if separator == mark and not any('"' in line for line in lines):
                continue
            rows, first, width = _rows(lines, separator, mark)
            if (rows, width) > best[:2]:
                best = (rows, width, separator, mark, first)
    rows, width, separator, mark, first = best
    if rows < FEWEST_ROWS:
        raise RecordingError(f"{path}: holds no table of numbers within its first {len(lines)} lines")
    return separator, mark, first, width


def _rows(lines: Sequence[str], separator: str, decimal: str) -> tuple[int, int, int]:
    """Number of rows of numbers, the first of them, and their number of cells."""
    widths = [_row_width(line, separator, decimal) for line in lines]
    counts = Counter(width for width in widths if width)
    if not counts:
        return 0, 0, 0
    width, rows = max(counts.items(), key=lambda item: (item[1], item[0]))
    first = next(
        (k for k in range(len(widths) - 1) if widths[k] == width and widths[k + 1] in (width, 0)), len(widths) - 1
    )
    return rows, first, width


def _row_width(line: str, separator: str, decimal: str) -> int:
    """Cells of a row of numbers; 0 for another line."""
    if line.lstrip().startswith(COMMENTS):
        return 0
    cells = split_cells(line, separator)
    filled = [cell for cell in cells if cell]
    if not filled or not any(cell[-1:].isdigit() or cell[-1:] in ".,MmZ" for cell in filled):
        return 0
    return len(cells) if all(is_number(cell, decimal) or is_clock(cell) for cell in cells) else 0


def _check_decimal(
    path: Path, rows: Sequence[Sequence[str]], separator: str, decimal: str, options: TextOptions
) -> None:
    """Refuse a file in which each comma may be a decimal mark or group thousands."""
    with_comma = [cell for cells in rows for cell in cells if "," in cell]
    if options.decimal or not with_comma or not all(is_undecided(cell) for cell in with_comma):
        return
    if separator == ";":  # a spreadsheet separates by semicolons where the comma is the decimal mark
        return
    if any("." in cell for cells in rows for cell in cells) and decimal == ".":
        return
    raise RecordingError(
        f"{path}: {with_comma[0]!r} may be {with_comma[0].replace(',', '.')} or {with_comma[0].replace(',', '')}; "
        "give --decimal , or --decimal ."
    )
