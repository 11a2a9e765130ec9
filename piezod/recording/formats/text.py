"""Recordings as text that a person, a spreadsheet or an instrument wrote: any separator, decimal mark and preamble.

`text_layout.find_layout` determines the layout. The rows are read in blocks of complete lines: a block of plain numbers
is brought to points and commas and parsed by numpy, any other one cell by cell. `metadata["understood"]` describes the
layout in a line.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf, isnan, nan
from pathlib import Path

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.clock_change import ClockChange
from piezod.recording.formats.csv_cells import parse_plain
from piezod.recording.formats.repairs import CUT_LINE, ZEROS, Repairs
from piezod.recording.formats.stream import MOST_VALUES, Array, RecordingStream, Table, increasing
from piezod.recording.formats.text_cells import COMMENTS, clock_s, number, split_cells, unwrapped
from piezod.recording.formats.text_layout import Layout, TextOptions, find_layout
from piezod.recording.names import TIME
from piezod.recording.quantities import UNITS

BLOCK = 2**22
"""Characters that are parsed together."""


@contextmanager
def open_text(path: Path, options: TextOptions = TextOptions()) -> Iterator[RecordingStream]:  # noqa: B008  frozen
    """Open a text file: its layout is found at once, rows are read with the chunks.

    Parameters
    ----------
    options
        Layout as the user states it.

    Raises
    ------
    RecordingError
        It holds no table of numbers, or a question that only the user can answer.
    """
    layout = find_layout(path, options)
    names = (TIME, *(column.channel for k, column in enumerate(layout.columns) if k != layout.time))

    metadata = layout.metadata | {"understood": layout.understood()}

    def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
        reader = _Rows(path, layout, Repairs(metadata))
        for table in reader.tables():
            columns = dict(zip(names, table, strict=True))
            yield {name: columns[name] for name in wanted}

    yield RecordingStream(path, names, lambda *request: increasing(chunks(*request), metadata), None, metadata)


class _Rows:
    """Reads the rows of a file once."""

    def __init__(self, path: Path, layout: Layout, repairs: Repairs) -> None:
        self._path, self._layout, self._repairs = path, layout, repairs
        self._line, self._samples = layout.head_lines, 0
        self._before_s = -inf
        self._clock = ClockChange(layout.first_day)
        self._plain = layout.date_form is None and layout.separator in "\t;, |"
        # Only these characters: digits, signs, exponents, the decimal mark, the separator and line ends.
        marks = re.escape(layout.separator + layout.decimal)
        self._other = re.compile(rf"[^0-9eE+\-\r\n \t{marks}]")
        self._widths = len(layout.columns)

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
                    table = self._parse(block + mark)
                    values += table.size
                    if values > MOST_VALUES:
                        raise RecordingError(f"{self._path}: has more than {MOST_VALUES:.3g} numbers; split it")
                    if table.size:
                        yield self._columns(table)
                elif len(rest) > BLOCK:
                    raise RecordingError(f"{self._path}: line {self._line + 1} is longer than {BLOCK} characters")
            if rest.strip():
                self._repairs.skipped(CUT_LINE if rest.strip("\0") else ZEROS, rest)

    def _parse(self, block: str) -> Array:
        """Numbers of a block of lines, shape (rows, columns)."""
        begun, self._line = self._line, self._line + block.count("\n")
        if self._plain and not self._other.search(block):
            try:
                return self._by_numpy(block)
            except ValueError:
                pass  # an empty cell, a row of another length: cell by cell
        return self._by_cells(block, begun)

    def _by_numpy(self, block: str) -> Array:
        separator, decimal = self._layout.separator, self._layout.decimal
        if separator in "\t ":
            block = (
                re.sub(r"[ \t]*[\t ][ \t]*", separator, block) if separator == "\t" else re.sub(r"[ \t]+", " ", block)
            )
        block = re.sub(rf"[{re.escape(separator)} \t\r]+\n", "\n", block)
        if separator == " ":
            block = re.sub(r"(?m)^ ", "", block)
        block = block.translate({ord(decimal): ".", ord(separator): ","})
        table = parse_plain(block.encode("ascii"))
        if table.size and table.shape[1] != self._widths:
            raise ValueError
        return table

    def _by_cells(self, block: str, begun: int) -> Array:
        layout, rows = self._layout, []
        for at, line in enumerate(block.split("\n"), begun + 1):
            if not line.strip() or line.lstrip().startswith(COMMENTS):
                continue
            cells = split_cells(line, layout.separator)
            cells += [""] * (self._widths - len(cells))
            if len(cells) != self._widths:
                raise RecordingError(
                    f"{self._path}: line {at} has {len(cells)} cells, the first row has {self._widths}"
                )
            rows.append([self._value(k, cell, at) for k, cell in enumerate(cells)])
        self._repairs.end_block()
        return np.array(rows, dtype=np.float64).reshape(-1, self._widths)

    def _value(self, k: int, cell: str, line: int) -> float:
        layout = self._layout
        try:
            if k == layout.time and layout.interval_s is not None:
                return nan
            if k == layout.time and layout.date_form is not None:
                return clock_s(cell, layout.date_form, layout.first_day)
            value = number(cell, layout.decimal, grouped=layout.grouped)
        except ValueError:
            what, name = ("a time" if k == layout.time else "a number"), layout.columns[k].written
            raise RecordingError(
                f"{self._path}: line {line}: '{name}' is {cell[:40]!r}, must be {what} or empty, or give --decimal"
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
        others = [np.ascontiguousarray(table[:, k]) for k in range(self._widths) if k != layout.time]
        return [time_s, *others]

    def _time_s(self, column: Array) -> Array:
        layout = self._layout
        if layout.date_form is None:
            factor = UNITS["time"][layout.columns[layout.time].unit]
            return np.ascontiguousarray(column) if factor == 1.0 else np.round(column * factor, 12)
        times_s = column.tolist() if layout.date_form else unwrapped(column.tolist(), self._before_s)
        self._before_s = times_s[-1]
        corrected_s = self._clock.corrected(np.array(times_s))
        self._repairs.clock(self._clock.notes)
        if self._samples == 0:
            self._origin_s = float(corrected_s[0])
        return np.round(corrected_s - self._origin_s, 9)
