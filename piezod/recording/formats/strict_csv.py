"""Strict reader of CSV files that drive a bench. No value is repaired, skipped or assumed.

The format: UTF-8; lines that begin with `#`; one header row; then rows of decimal numbers with commas between. Every
line ends with a line end. A line that begins with `#` may also stand between two rows. Every other deviation is refused
with its line: a word, an empty cell, a comment behind a row, a blank line between rows, a row of another length.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.config.reference import MOST_BYTES
from piezod.errors import RecordingError
from piezod.recording.formats.access import library_errors, open_file
from piezod.recording.names import TIME, channel_name, name_columns

_NUMBER = r"[ \t]*[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?[ \t]*"
_CELL = re.compile(_NUMBER)
_QUOTED = 60  # characters of a line that a message quotes


@dataclass(frozen=True)
class StrictTable:
    """Numbers of a file, with the line of each row.

    Parameters
    ----------
    names
        Names of the columns, `time_s` first.
    values
        Finite numbers, shape (rows, columns), at least one row. The time never falls.
    lines
        Line of each row, counted from 1, shape (rows,).
    time_unit_s
        Unit of the last written decimal of the times [s]; 0: unknown, some time has an exponent.
    """

    path: Path
    names: tuple[str, ...]
    values: Array
    lines: NDArray[np.int64]
    time_unit_s: float

    @property
    def time_s(self) -> Array:
        """Time of each row [s], shape (rows,)."""
        return self.values[:, 0]

    def column(self, name: str) -> Array:
        """Values of a column, shape (rows,).

        Raises
        ------
        RecordingError
            The file has no such column; the message names the existing columns.
        """
        if name not in self.names[1:]:
            raise RecordingError(f"{self.path}: has no column {name}, has {', '.join(self.names[1:])[:200]}")
        return self.values[:, self.names.index(name)]


def read_strict_csv(path: Path) -> StrictTable:
    """Read a CSV file that drives a bench.

    Parameters
    ----------
    path
        Regular file of at most `MOST_BYTES`.

    Raises
    ------
    RecordingError
        The file cannot be read or deviates from the format; the message names file, line, column and value.
    """
    with library_errors(path, "read"):
        text = _text(path)
        lines = [line.removesuffix("\r") for line in text.split("\n")[:-1]]
        header = next((k for k, line in enumerate(lines) if line.strip() and not line.startswith("#")), None)
        if header is None:
            raise RecordingError(f"{path}: is empty, must hold a header row and rows of numbers")
        names = _names(lines[header], path)
        numbers = _rows(lines, header + 1, path)
        if not numbers:
            raise RecordingError(f"{path}: has a header but no rows")
        rows = [lines[k] for k in numbers]
        _check_cells(rows, numbers, names, path)
        values = np.loadtxt(rows, delimiter=",", comments=None, ndmin=2)
    table = StrictTable(path, names, values, np.array(numbers) + 1, _time_unit_s(rows))
    _check_finite(table)
    _check_order(table)
    return table


def _text(path: Path) -> str:
    """Content of the file; the last line must be complete."""
    with open_file(path, MOST_BYTES) as file:
        raw = file.read(MOST_BYTES)
    if raw and not raw.endswith(b"\n"):
        number, last = raw.count(b"\n") + 1, raw[raw.rfind(b"\n") + 1 :][:_QUOTED].decode("utf-8", "replace")
        raise RecordingError(
            f"{path}: line {number}, the last one, is {last!r} without a line end, may be cut short; write the file "
            "again, or end the line"
        )
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise RecordingError(f"{path}: line {line} is not UTF-8 text: {error.reason}") from None


def _names(line: str, path: Path) -> tuple[str, ...]:
    """Names of the columns from the header row."""
    cells = line.split(",")
    if channel_name(cells[0]) != TIME:
        raise RecordingError(f"{path}: first column is {cells[0].strip()[:40]!r}, must be {TIME}")
    return name_columns(path, [(cell, "") for cell in cells])


def _rows(lines: Sequence[str], first: int, path: Path) -> list[int]:
    """Indices of the lines that hold rows; blank lines may only stand at the end."""
    numbers = [k for k in range(first, len(lines)) if not lines[k].startswith("#")]
    while numbers and not lines[numbers[-1]].strip():
        numbers.pop()
    blank = next((k for k in numbers if not lines[k].strip()), None)
    if blank is not None:
        raise RecordingError(
            f"{path}: line {blank + 1} is blank between two rows; are rows missing? write the file again"
        )
    return numbers


def _check_cells(rows: Sequence[str], numbers: Sequence[int], names: Sequence[str], path: Path) -> None:
    """Refuse the first row that is not one number for each column."""
    row_form = re.compile(",".join([_NUMBER] * len(names)))
    wrong = next((k for k, row in enumerate(rows) if not row_form.fullmatch(row)), None)
    if wrong is None:
        return
    place, cells = f"{path}: line {numbers[wrong] + 1}", rows[wrong].split(",")
    for name, cell in zip(names, cells, strict=False):
        if not _CELL.fullmatch(cell):
            raise RecordingError(
                f"{place}: {name} is {cell.strip()[:40]!r}, must be a number; a file that drives is read strictly"
            )
    raise RecordingError(f"{place} has {len(cells)} cells, the header names {len(names)} columns")


def _check_finite(table: StrictTable) -> None:
    """Refuse a number beyond the range of float64."""
    bad = np.argwhere(~np.isfinite(table.values))
    if bad.size:
        row, column = bad[0]
        value, name = table.values[row, column], table.names[column]
        raise RecordingError(f"{table.path}: line {table.lines[row]}: {name} is {value:g}, must be finite")


def _check_order(table: StrictTable) -> None:
    """Refuse a time that falls, or a third row with an equal time: the row between would never act."""
    steps = np.diff(table.time_s)
    falls = np.flatnonzero(steps < 0.0)
    if falls.size:
        k = falls[0] + 1
        raise RecordingError(
            f"{table.path}: line {table.lines[k]}: {TIME} is {table.time_s[k]:.12g} after "
            f"{table.time_s[k - 1]:.12g}, must not fall"
        )
    thrice = np.flatnonzero((steps[:-1] == 0.0) & (steps[1:] == 0.0))
    if thrice.size:
        k = thrice[0] + 2
        raise RecordingError(
            f"{table.path}: line {table.lines[k]} is the third row at {table.time_s[k]:.12g} s, at most two may have "
            "the same time (a jump)"
        )


def _time_unit_s(rows: Sequence[str]) -> float:
    """Unit of the last decimal of the times [s]; 0 where a time has an exponent."""
    times = [row.partition(",")[0].strip() for row in rows]
    if any("e" in time or "E" in time for time in times):
        return 0.0
    return float(10.0 ** -max(len(time.partition(".")[2]) for time in times))
