"""Layout of delimited text: encoding, separator, decimal mark, preamble, header and units, columns.

A sample from the begin of the file decides. If its cells leave a question open, the file is refused with the option
that does.
"""

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from piezod.errors import RecordingError, UsageError
from piezod.recording.formats.scale import parse_scale
from piezod.recording.formats.text_cells import (
    day_of,
    is_grouped,
    is_undecided,
    split_cells,
)
from piezod.recording.formats.text_head import (
    MOST_PREAMBLE_LINES,
    ROW,
    check_names,
    columns_of,
    head_of,
    joined,
    metadata_of,
    stated_interval_s,
    time_column,
    with_time_unit,
    with_unit,
)
from piezod.recording.formats.text_rows import SEPARATORS, RowTable, find_rows, first_row, row_width, text_cells
from piezod.recording.quantities import Column

SAMPLE = 2**18  # bytes from the begin of the file that decide about its layout
MOST_LEFT_OUT = 200  # characters of the list of ignored columns


@dataclass(frozen=True)
class TextOptions:
    """Layout of a text file as the user states it.

    Parameters
    ----------
    columns
        Names of all columns in their order, such as `time_ms`, `voltage_V`. Or the wanted ones as `NAME=WRITTEN`, by
        their name or path in the file. Empty: from the file's header.
    rate_Hz
        Samples per second, for a file without a column of time; None: from the file.
    decimal
        Decimal mark, a point or a comma; empty: from the file.
    scale
        Conversions of columns, such as `CH2=100 N/V`.
    """

    columns: tuple[str, ...] = ()
    rate_Hz: float | None = None
    decimal: str = ""
    scale: tuple[str, ...] = ()

    @property
    def is_stated(self) -> bool:
        """Whether the user states anything that the reader of a text must know."""
        return bool(self.columns or self.rate_Hz or self.decimal)

    @classmethod
    def of(
        cls, columns: str | None, rate_Hz: float | None, decimal: str | None, scale: Sequence[str] | None = None
    ) -> "TextOptions":
        """Options of a command.

        Parameters
        ----------
        columns
            Names with commas between; None: not given.
        rate_Hz, decimal, scale
            As for the class; None: not given.

        Raises
        ------
        UsageError
            A name is empty, the decimal mark is neither a point nor a comma, or a conversion has another form.
        """
        names = () if columns is None else tuple(name.strip() for name in columns.split(","))
        if not all(names):
            raise UsageError(f"--columns is '{columns}', must be names with commas between")
        if decimal not in (None, ".", ","):
            raise UsageError(f"--decimal is '{decimal}', must be . or ,")
        for conversion in scale or ():
            parse_scale(conversion)
        return cls(names, rate_Hz, decimal or "", tuple(scale or ()))


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
        Name, quantity and unit of each column that is read.
    places
        Numbers of their cells in a row, increasing.
    width
        Cells of a row.
    time
        Index of the column of time in `columns`; -1: there is none.
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
    own
        Whether the file is a recording as piezod writes it.
    header
        Lines of names and units, which may be repeated amid the rows.
    extra
        Names of columns behind the last cell of a row, which only few rows fill.
    date_place
        Number of the cell with the date, where the time of day has its own cell; -1: there is none.
    since_1970
        Whether times count from 1970; they are read from the first sample on.
    """

    encoding: str
    separator: str
    decimal: str
    grouped: bool
    head_lines: int
    columns: tuple[Column, ...]
    places: tuple[int, ...]
    width: int
    time: int = -1
    date_form: str | None = None
    first_day: int = 0
    interval_s: float | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    own: bool = False
    header: frozenset[str] = frozenset()
    extra: tuple[str, ...] = ()
    date_place: int = -1
    since_1970: bool = False

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
    encoding, lines = _begin(path)
    table = find_rows(path, lines[: 2 * MOST_PREAMBLE_LINES], options.decimal)
    separator, width = table.separator, table.width
    first = first_row(lines, table)
    decimal, words, rows = _rows_below(lines[first:], table, options)
    _check_decimal(path, rows, separator, decimal, options)
    head = head_of(lines[:first], separator, width)
    notes: list[str] = []
    columns = columns_of(path, options.columns, head, rows, width)
    if columns[0].written == ROW != head.names[0]:
        notes.append(f"the first column has no name and counts rows, it is called {ROW}")
    time, date_form, date_place = time_column(path, columns, rows, decimal)
    interval_s, since_1970 = None, False
    if options.rate_Hz:
        interval_s, date_form = 1.0 / options.rate_Hz, None
        if time >= 0:
            notes.append(f"'{columns[time].written}' is not used, --rate-Hz is given")
            words, time = words | {time}, -1
    elif time >= 0:
        columns, since_1970 = with_time_unit(path, columns, time, rows, date_form, notes)
    elif (interval_s := stated_interval_s(lines[:first], decimal)) is None:
        raise RecordingError(
            f"{path}: has no column of time, has {', '.join(column.written for column in columns)[:120]}; "
            "give --rate-Hz, or name the columns with --columns time_s,..."
        )
    unused = {k for k, column in enumerate(columns) if column.quantity == "time" and k != time}
    unwanted = {k for k, column in enumerate(columns) if options.columns and not column.written} - {time}
    places = tuple(k for k in range(width) if k == time or k not in words | unused | unwanted)
    left_out = [columns[k].written for k in sorted(words | unused) if k not in (time, date_place)]
    if left_out:
        notes.append(f"left out: {', '.join(map(repr, left_out))[:MOST_LEFT_OUT]}, no column of numbers")
    for k in () if options.decimal else places:
        _check_grouped(path, columns[k].written, [cells[k] for cells in rows if k < len(cells)], decimal)
    columns = tuple(with_unit(columns[k], notes) for k in places)
    check_names(path, columns)
    if not any(k != time for k in places):
        raise RecordingError(f"{path}: has no column of numbers beside the time; name the columns with --columns")
    return Layout(
        encoding,
        separator,
        decimal,
        any(is_grouped(cells[k], decimal) for cells in rows for k in places if k < len(cells)),
        first,
        columns,
        places,
        width,
        places.index(time) if time >= 0 else -1,
        date_form,
        day_of(joined(rows[0], date_place, time), date_form) if date_form else 0,
        interval_s,
        metadata_of(head.above),
        tuple(notes),
        header=head.lines,
        extra=head.extra,
        date_place=date_place,
        since_1970=since_1970,
    )


def _rows_below(
    lines: Sequence[str], table: "RowTable", options: TextOptions
) -> tuple[str, frozenset[int], list[list[str]]]:
    """Decimal mark, cells of words, and cells of the rows of numbers, of the lines from the first row on."""
    separator, decimal = table.separator, table.decimal
    words = table.words | text_cells(lines, separator, decimal, table.width)
    if separator == ";" and not options.decimal and not any("," in line for line in lines):
        decimal = "."  # a point is a decimal mark where no comma is
    rows = [
        cells
        for line in lines
        if row_width(line, separator, decimal, words) == table.width and (cells := split_cells(line, separator))
    ]
    return decimal, words, rows


def _begin(path: Path) -> tuple[str, list[str]]:
    """Encoding and first lines of a text."""
    with path.open("rb") as file:
        raw = file.read(SAMPLE)
    if not raw.strip(b"\0 \t\r\n\xef\xbb\xbf"):
        raise RecordingError(f"{path}: is empty, must hold a header row and samples")
    encoding = encoding_of(raw)
    text = raw.decode(encoding, errors="replace")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return encoding, lines[:-1] if len(raw) == SAMPLE else lines  # the last one is perhaps cut


def _check_grouped(path: Path, name: str, cells: Sequence[str], decimal: str) -> None:
    """Refuse a column in which `1.234` may be 1.234 or 1234: no cell shows whether marks group thousands.

    A whole number below 1000, several groups, or decimals behind a group show it.
    """
    mark = "." if decimal == "," else ","
    doubtful = re.compile(rf"[+-]?[1-9]\d{{0,2}}\{mark}\d{{3}}", re.ASCII)
    cells = [cell.strip() for cell in cells]
    found = [cell for cell in cells if doubtful.fullmatch(cell)]
    if not found or any(is_grouped(cell, decimal) and not doubtful.fullmatch(cell) for cell in cells):
        return
    if any(cell.lstrip("+-").isdecimal() and len(cell.lstrip("+-")) <= 3 for cell in cells):
        return
    whole = found[0].replace(mark, "")
    raise RecordingError(
        f"{path}: '{name}' is {found[0]!r}, may be {whole} or {whole[:-3]}{decimal}{whole[-3:]}; "
        f"give --decimal {decimal} if it is {whole}, else export one decimal mark"
    )


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
