"""Recordings as text, of piezod itself or as a person, a spreadsheet or an instrument wrote it.

`find_layout` or `own_layout` determines the layout. The rows are read in blocks of complete lines. A line of other than
plain numbers is brought to plain numbers by itself or left out; then the block is parsed by pyarrow or numpy.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from math import inf, isnan
from pathlib import Path

import numpy as np

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording.formats.access import library_errors
from piezod.recording.formats.csv import own_layout
from piezod.recording.formats.plain_rows import row_parser
from piezod.recording.formats.repairs import COMMENT, CUT_LINE, EXTRA, HEADER, SUMMARY, ZEROS, Repairs, is_missing
from piezod.recording.formats.stream import MOST_VALUES, RecordingStream, Table, increasing, read_all
from piezod.recording.formats.text_cells import (
    COMMENTS,
    ZONE,
    ClockChange,
    clock_s,
    is_clock,
    is_number,
    number,
    split_cells,
    unwrapped,
)
from piezod.recording.formats.text_layout import Layout, TextOptions, find_layout
from piezod.recording.names import TIME
from piezod.recording.quantities import UNITS
from piezod.recording.recording import Recording

FEWEST_COLUMNS = 3  # time, input and output; a further column may be left out
BLOCK = 2**22  # characters that are parsed together: the numbers fit into the processor's cache, and calls cost little
LARGE = 2**24  # file size above which parsing by pyarrow saves more time than its import costs [bytes]
OVERLOAD = 9.8e37
"""Magnitude from which a finite number is an overload: SCPI writes 9.9E37 and 9.91E37, others 1E38 and 3.4E38."""

_EMPTY_CELL = re.compile(rb"(?m)(?<=,)[ \t]*(?=,|$)|^[ \t]*(?=,)")
_NAN = re.compile(rb"NaN(?=[,;\t|\n])")
_BEHIND = re.compile(r"\s#")


def read_csv(path: Path) -> Recording:
    """Read a CSV recording as `write_csv` writes it, with any suffix.

    Raises
    ------
    RecordingError
        The file cannot be read; the message names file, line, column and the wrong value.
    """
    with library_errors(path, "read"), open_text(path, own=True) as stream:
        return read_all(stream)


@contextmanager
def open_text(path: Path, options: TextOptions = TextOptions(), *, own: bool = False) -> Iterator[RecordingStream]:  # noqa: B008  frozen
    """Open a text file: its layout is found at once, rows are read with the chunks.

    Parameters
    ----------
    options
        Layout as the user states it.
    own
        Whether a text of another layout than that of `write_csv` is refused.

    Raises
    ------
    RecordingError
        It holds no table of numbers, or a question that only the user can answer.
    """
    layout = (None if options.is_stated else own_layout(path, required=own)) or find_layout(path, options)
    names = (TIME, *(column.channel for k, column in enumerate(layout.columns) if k != layout.time))
    metadata = layout.metadata | ({} if layout.own else {"understood": layout.understood()})

    def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
        reader = _Rows(path, layout, Repairs(metadata))
        for table in reader.tables():
            columns = dict(zip(names, table, strict=True))
            yield {name: columns[name] for name in wanted}

    yield RecordingStream(path, names, lambda *request: increasing(chunks(*request), metadata), None, metadata)


def with_empty_cells(rows: bytes) -> bytes:
    """Rows of plain numbers with `nan` in empty cells."""
    return _EMPTY_CELL.sub(b"nan", rows)


def without_empty_ends(rows: bytes) -> bytes:
    """Rows of plain numbers without the empty cells at their ends, `nan` in the other empty cells."""
    return with_empty_cells(re.sub(rb"[, \t]+\n", b"\n", rows))


class _WordsWithCommasError(Exception):
    """A comma in a file of another separator stands in a word or groups thousands."""


class _Rows:
    """Reads the rows of a file once."""

    def __init__(self, path: Path, layout: Layout, repairs: Repairs) -> None:
        self._path, self._layout, self._repairs = path, layout, repairs
        self._line, self._samples = layout.head_lines, 0
        self._before_s = -inf
        self._clock = ClockChange(layout.first_day)
        self._tail: RecordingError | None = None  # the first line that may belong to a summary
        self._width = layout.width
        self._parse_rows = row_parser(self._width, layout.places, large=path.stat().st_size > LARGE)
        self._words = len(layout.places) < self._width
        self._has_dates = layout.date_form is not None
        self._begins_with_date = layout.date_place < 0 and layout.places[layout.time] == 0 and layout.separator != " "
        self._usual = b"0123456789eEna+- \t\n" + (layout.separator + layout.decimal).encode()
        # Bytes of a line that is cleaned by itself; in a row with words, every character may be part of a word.
        self._odd = re.compile(rb'["#\0]' if self._words else rb"[^" + re.escape(self._usual) + rb"]")

    def tables(self) -> Iterator[list[Array]]:
        """Time [s] and the other columns, block after block."""
        values = 0
        with self._path.open(encoding=self._layout.encoding, errors="replace") as file:
            for _ in range(self._layout.head_lines):
                file.readline()
            rest = ""
            while text := file.read(BLOCK):
                block, mark, rest = (rest + text).rpartition("\n")
                if mark:
                    table = self._parse((block + mark).encode())
                    self._remove_overloads(table)
                    self._repairs.end_block()
                    values += table.size
                    if values > MOST_VALUES:
                        raise RecordingError(f"{self._path}: has more than {MOST_VALUES:.3g} numbers; split it")
                    if table.size:
                        yield self._columns(table)
                elif len(rest) > BLOCK:
                    raise RecordingError(f"{self._path}: has a line longer than {BLOCK} bytes, line {self._line + 1}")
            if rest.strip():
                self._repairs.skipped(ZEROS if "\0" in rest else CUT_LINE, rest)

    def _parse(self, block: bytes) -> Array:
        """Numbers of a block of lines, shape (rows, columns)."""
        begun, self._line = self._line, self._line + block.count(b"\n")
        before = self._tail, self._repairs.counts()
        for repaired in (bytes, with_empty_cells, without_empty_ends) if (rows := self._rows(block, begun)) else ():
            try:
                return self._parse_rows(repaired(rows))
            except ValueError:
                pass  # an empty cell, a word, a row of another length
        self._tail = before[0]
        self._repairs.set_counts(before[1])
        lines = block.split(b"\n")
        return self._parse_rows(b"".join(self._clean(line, at) for at, line in enumerate(lines, begun + 1)))

    def _remove_overloads(self, table: Array) -> None:
        """Read the numbers that instruments write for an overload as missing, in place."""
        if self._layout.own or not table.size:
            return
        if np.nanmax(np.abs(table), initial=0.0) >= OVERLOAD:
            overloads = np.isfinite(table) & (np.abs(table) >= OVERLOAD)
            for value in table[overloads]:
                self._repairs.missing(f"{value:.3g}")
            table[overloads] = np.nan

    def _rows(self, block: bytes, begun: int) -> bytes:
        """Rows of plain numbers, with few lines cleaned; empty where each line must be."""
        try:
            if not self._has_dates:
                return self._with_clean_lines(block, begun)
            return self._with_seconds(block, begun) if self._begins_with_date else b""
        except _WordsWithCommasError:
            return b""

    def _with_clean_lines(self, block: bytes, begun: int) -> bytes:
        """Rows with commas and points; lines with other than plain numbers are cleaned one by one."""
        if not self._words:
            if not block.translate(None, self._usual):
                return self._plain(block)
            block = _NAN.sub(b"nan", block)
        parts, at, number_at = [], 0, begun + 1
        while odd := self._odd.search(block, at):
            start = block.rfind(b"\n", at, odd.start()) + 1 or at
            end = block.index(b"\n", odd.start())
            parts.append(self._plain(block[at:start]))
            number_at += block.count(b"\n", at, start)
            parts.append(self._clean(block[start:end], number_at))
            at, number_at = end + 1, number_at + 1
        return b"".join([*parts, self._plain(block[at:])])

    def _with_seconds(self, block: bytes, begun: int) -> bytes:
        """Rows with the time [s] in place of a date; a line with other than plain numbers behind it is cleaned."""
        layout, parts = self._layout, []
        separator = layout.separator.encode()
        for at, line in enumerate(block.split(b"\n"), begun + 1):
            stamp, mark, rest = line.partition(separator)
            seconds = None
            if mark and not rest.translate(None, self._usual):
                with suppress(ValueError):
                    seconds = clock_s(stamp.decode("utf-8", "replace"), layout.date_form or "", layout.first_day)
            parts.append(self._clean(line, at) if seconds is None else b"%r,%b\n" % (seconds, self._plain(rest)))
        return b"".join(parts)

    def _plain(self, rows: bytes) -> bytes:
        """Rows of plain numbers with commas and points instead of the file's own marks."""
        if self._tail is not None and rows.strip():
            raise self._tail
        separator, decimal = self._layout.separator.encode(), self._layout.decimal.encode()
        if self._words and separator != b"," != decimal and b"," in rows:
            raise _WordsWithCommasError
        if separator == b" ":
            rows = re.sub(rb"(?m)^ | (?=\n)", b"", re.sub(rb"[ \t]+", b" ", rows))
        if separator != b"," or decimal != b".":
            rows = rows.translate(bytes.maketrans(decimal + separator, b".,"))
        return rows

    def _clean(self, raw: bytes, line: int) -> bytes:
        """A line as a row of plain numbers; empty if it holds no row."""
        text = raw.decode("utf-8", "replace").strip("\r\n")
        if "\0" in text:
            self._repairs.skipped(ZEROS, text)
            text = text.rpartition("\0")[2]
        bare = text.strip()
        marks = "#" if self._layout.own else COMMENTS
        if not bare or (bare.startswith(marks) and not is_missing(self._cells(bare)[0])):
            return b""
        if bare in self._layout.header:
            self._repairs.skipped(HEADER, bare)
            return b""
        try:
            values = self._values(text, line)
        except RecordingError as error:
            if self._is_time(text):
                raise
            self._tail = self._tail or error
            self._repairs.skipped(SUMMARY, bare)
            return b""
        if self._tail is not None:
            raise self._tail
        row = ["0"] * self._width
        for place, value in zip(self._layout.places, values, strict=True):
            row[place] = repr(value)
        return ",".join(row).encode() + b"\n"

    def _cells(self, text: str) -> list[str]:
        return split_cells(text, self._layout.separator) or [""]

    def _is_time(self, text: str) -> bool:
        """Whether a line begins a sample: it has a time."""
        layout = self._layout
        cells, place = self._cells(text), layout.places[max(layout.time, 0)]
        return place < len(cells) and (is_number(cells[place], layout.decimal) or is_clock(cells[place]))

    def _values(self, text: str, line: int) -> list[float]:
        """Numbers of a row, without the text after them."""
        try:
            return self._numbers(text, line)
        except RecordingError:
            behind = _BEHIND.search(text)
            if behind is None:
                raise
            values = self._numbers(text[: behind.start()], line)
            self._repairs.skipped(COMMENT, text[behind.start() :])
            return values

    def _numbers(self, text: str, line: int) -> list[float]:
        layout, width = self._layout, self._width
        cells = self._cells(text)
        further = cells[width : width + len(layout.extra)]
        present = len(cells) if layout.separator == " " else max(len(cells), text.count(layout.separator) + 1)
        if len(cells) > width + len(further) or present <= max(layout.places):
            raise RecordingError(f"{self._path}: line {line} has {len(cells)} cells, the header names {width} columns")
        for name, cell in zip(layout.extra, further, strict=False):
            self._repairs.skipped(EXTRA, f"{name}: {cell}")
        cells += [""] * (width - len(cells))
        if layout.date_place >= 0:
            cells[layout.places[layout.time]] = f"{cells[layout.date_place]} {cells[layout.places[layout.time]]}"
        return [self._value(k, cells[place], line) for k, place in enumerate(layout.places)]

    def _value(self, k: int, cell: str, line: int) -> float:
        layout = self._layout
        try:
            if k == layout.time and layout.date_form is not None:
                return clock_s(cell, layout.date_form, layout.first_day)
            value = number(cell, layout.decimal, grouped=layout.grouped)
        except ValueError:
            written = layout.columns[k].written
            name = written if layout.own else f"'{written}'"
            wanted = "a time" if k == layout.time and not layout.own else "a number"
            hint = "" if layout.own else ", or give --decimal"
            if len(layout.columns) > FEWEST_COLUMNS and k != layout.time:
                hint += "; or choose columns without it, --columns NAME=COLUMN,..."
            raise RecordingError(
                f"{self._path}: line {line}: {name} is {cell.strip()[:40]!r}, must be {wanted} or empty{hint}"
            ) from None
        if isnan(value):
            self._repairs.missing(cell)
        return value

    def _columns(self, table: Array) -> list[Array]:
        layout, rows = self._layout, table.shape[0]
        if layout.interval_s is not None:
            time_s = layout.interval_s * np.arange(self._samples, self._samples + rows)
        else:
            time_s = self._time_s(table[:, layout.time])
        self._samples += rows
        others = [np.ascontiguousarray(table[:, k]) for k in range(table.shape[1]) if k != layout.time]
        return [time_s, *others]

    def _time_s(self, column: Array) -> Array:
        layout = self._layout
        if layout.date_form is None:
            if self._samples == 0:
                self._origin_s = float(column[0]) if layout.since_1970 else 0.0
            factor = UNITS["time"][layout.columns[layout.time].unit]
            since = column - self._origin_s if layout.since_1970 else column
            return np.ascontiguousarray(since) if factor == 1.0 else np.round(since * factor, 12)
        has_date = layout.date_form not in ("", ZONE)
        times_s = column.tolist() if has_date else unwrapped(column.tolist(), self._before_s)
        self._before_s = times_s[-1]
        has_zone = layout.date_form.endswith(ZONE)
        corrected_s = np.array(times_s) if has_zone else self._clock.corrected(np.array(times_s))
        self._repairs.clock(self._clock.notes)
        if self._samples == 0:
            self._origin_s = float(corrected_s[0])
        return np.round(corrected_s - self._origin_s, 9)
