"""Separator and decimal mark of a text, and its rows of numbers.

Each pair of separator and decimal mark is tried; the pair under which most lines are rows of numbers with an equal
number of cells is taken.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from piezod.errors import RecordingError
from piezod.recording.formats.text_cells import COMMENTS, is_clock, is_number, split_cells

SEPARATORS = {"\t": "tab", ";": "semicolon", ",": "comma", "|": "bar", " ": "spaces"}
FEWEST_NUMBERS = 2  # columns of numbers of a table that has columns of words too
FEWEST_ROWS = 2  # rows of numbers that a table must begin with, so that a line of the preamble is not taken for one


class RowTable(NamedTuple):
    """Rows of numbers under a separator and a decimal mark."""

    rows: int
    numbers: int
    separator: str
    decimal: str
    first: int
    width: int
    words: frozenset[int]


def find_rows(path: Path, lines: Sequence[str], decimal: str) -> RowTable:
    """The separator and decimal mark under which most lines are rows of numbers, then those with most numbers.

    Columns of words are supposed where fewer than half of the lines are rows of numbers alone.
    """
    marks = {
        separator: (decimal,) if decimal else (",", ".") if separator == ";" else (".", ",") for separator in SEPARATORS
    }
    pairs = [(separator, mark) for separator in SEPARATORS for mark in marks[separator]]
    quoted = any('"' in line for line in lines)
    tables = [_rows(lines, *pair, frozenset()) for pair in pairs if quoted or pair[0] != pair[1]]
    best = max(tables, key=lambda table: table[:2])
    if 2 * best.rows < sum(1 for line in lines if line.strip()):
        words = {pair: _word_cells(lines, *pair) for pair in pairs if pair[0] != pair[1]}
        tables = [_rows(lines, *pair, cells) for pair, cells in words.items() if cells]
        tables = [table for table in tables if table.numbers >= FEWEST_NUMBERS and table.rows > 2 * best.rows]
        best = max(tables, key=lambda table: (table.rows, -len(table.words), table.numbers), default=best)
    if best.rows < FEWEST_ROWS:
        raise RecordingError(f"{path}: holds no table of numbers within its first {len(lines)} lines")
    return best


def first_row(lines: Sequence[str], table: RowTable) -> int:
    """Index of the first row, also where words behind its numbers make it look like a header."""
    first = table.first
    while first > 0 and (cells := split_cells(lines[first - 1], table.separator))[table.width :]:
        row = table.separator.join(cells[: table.width])
        if row_width(row, table.separator, table.decimal, table.words) != table.width:
            break
        if all(is_number(cell, table.decimal) for cell in cells[table.width :]):
            break
        first -= 1
    return first


def text_cells(rows: Sequence[str], separator: str, decimal: str, width: int) -> frozenset[int]:
    """Cells that hold words where they are not empty, such as remarks on single samples.

    Parameters
    ----------
    rows
        Lines from the first sample on.
    separator, decimal
        Characters between two cells, and before the decimals.
    width
        Cells of a row.
    """
    if separator == " ":
        return frozenset()
    with_words: set[int] = set()
    with_numbers: set[int] = set()
    for row in rows:
        if row.startswith(COMMENTS):
            continue
        for k, cell in enumerate(split_cells(row, separator)[:width]):
            if not cell or k in with_numbers:
                continue
            if is_number(cell, decimal) or is_clock(cell):
                with_numbers.add(k)
            else:
                with_words.add(k)
    return frozenset(with_words - with_numbers)


def _word_cells(lines: Sequence[str], separator: str, decimal: str) -> frozenset[int]:
    """Cells that hold words in most lines of the most frequent number of cells."""
    rows = [split_cells(line, separator) for line in lines]
    widths = Counter(len(cells) for cells in rows if len(cells) > FEWEST_NUMBERS)
    width = max(widths, key=lambda width: (widths[width], width), default=0)
    table = [cells for cells in rows if len(cells) == width]
    return frozenset(
        k
        for k in range(width)
        if 2 * sum(1 for cells in table if not (is_number(cells[k], decimal) or is_clock(cells[k]))) > len(table)
    )


def _rows(lines: Sequence[str], separator: str, decimal: str, words: frozenset[int]) -> RowTable:
    """Rows of numbers with the most frequent number of cells."""
    widths = [row_width(line, separator, decimal, words) for line in lines]
    counts = Counter(width for width in widths if width)
    width, rows = max(counts.items(), key=lambda item: (item[1], item[0]), default=(0, 0))
    first = next(
        (k for k in range(len(widths) - 1) if widths[k] == width and widths[k + 1] in (width, 0)), len(widths) - 1
    )
    return RowTable(rows, width - len(words), separator, decimal, first, width, words)


def row_width(line: str, separator: str, decimal: str, words: frozenset[int]) -> int:
    """Cells of a row of numbers and words; 0 for another line."""
    if line.lstrip().startswith(COMMENTS):
        return 0
    cells = split_cells(line, separator)
    numbers = [cell for k, cell in enumerate(cells) if k not in words]
    if not any(cell[-1:].isdigit() or cell[-1:] in (*".,MmZ",) or is_clock(cell) for cell in numbers if cell):
        return 0
    return len(cells) if all(is_number(cell, decimal) or is_clock(cell) for cell in numbers) else 0
