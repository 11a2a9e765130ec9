"""Numbers from the cells of CSV text, by numpy or by pyarrow.

Both libraries round to the nearest double. pyarrow is faster, and it parses only blocks of plain numbers. numpy parses
every other block of numbers. A block with words, comments or wrong rows is parsed cell by cell. So a file gives the
same numbers, or an equal error message, with and without pyarrow.
"""

import importlib
import io
import re
import warnings
from collections.abc import Callable, Sequence
from math import nan
from pathlib import Path
from typing import NoReturn

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.repairs import COMMENT, MINUS, ZEROS, Repairs, is_missing
from piezod.recording.formats.stream import Array

MEGABYTE = 2**20

Parser = Callable[[bytes], Array]

_NUMBER = re.compile(rf"[+\-{MINUS}]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+\-{MINUS}]?[0-9]+)?")
_EMPTY_CELL = re.compile(rb"(?m)(?<=,)[ \t]*(?=,|\r?$)|^[ \t]*(?=,)")
_COMMENT = re.compile(r"\s#")
# Characters of the blocks that pyarrow parses.
_PLAIN = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ+-.,\r\n"


def parse(
    block: bytes, path: Path, names: Sequence[str], position: int, arrow: Parser | None, repairs: Repairs | None = None
) -> Array:
    """Numbers of a block of complete lines, shape (rows, columns); a missing sample is nan.

    Parameters
    ----------
    block
        Text that ends in a newline.
    path, names, position
        File, its column names, and the position of the block in it [bytes]; for messages.
    arrow
        Parser from `arrow_parser`; None: numpy parses the block.
    repairs
        Takes note of words for missing samples and of text behind rows; None: not counted.

    Raises
    ------
    RecordingError
        A cell holds no number, or a row has another number of cells than the header. The message names the first.
    """
    for parser in (arrow, _by_numpy, _with_empty_cells):
        try:
            table = None if parser is None else parser(block)
        except ValueError:
            continue  # a word, a comment, or a row of another length
        if table is not None and (not table.size or table.shape[1] == len(names)):
            return table
    return _by_cells(block, path, names, position, repairs or Repairs({}))


def arrow_parser(columns: int) -> Parser | None:
    """Parser by pyarrow for rows of `columns` cells; None if pyarrow is not installed.

    The parser raises ValueError for a block that it leaves to numpy.

    Parameters
    ----------
    columns
        Cells per row, at least 1; the parser refuses rows of a single cell.

    Returns
    -------
    Parser from the bytes of N rows to numbers, shape (N, columns), or None.
    """
    try:
        arrow, arrow_csv = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.csv")
    except ImportError:
        return None
    names = [str(k) for k in range(columns)]
    reading = arrow_csv.ReadOptions(column_names=names, block_size=2**26)
    parsing = arrow_csv.ParseOptions(quote_char=False)
    types = dict.fromkeys(names, arrow.float64())
    converting = arrow_csv.ConvertOptions(column_types=types, null_values=["", "nan"])

    def by_arrow(block: bytes) -> Array:
        if columns < 2 or block.translate(None, _PLAIN):
            raise ValueError  # characters that the two libraries may interpret differently
        table = arrow_csv.read_csv(arrow.BufferReader(block), reading, parsing, converting)
        result = np.empty((table.num_rows, columns))
        for k, column in enumerate(table.columns):
            result[:, k] = column.to_numpy()
        return result

    return by_arrow


def parse_plain(block: bytes) -> Array:
    """Numbers of a block of complete lines of plain numbers with commas between, shape (rows, columns).

    Parameters
    ----------
    block
        ASCII text that ends in a newline.

    Raises
    ------
    ValueError
        A cell is empty or holds no number, or the rows have different lengths.
    """
    return _by_numpy(block)


def _by_numpy(block: bytes) -> Array:
    if b"#" in block:
        raise ValueError  # a comment, or the #IND and #N/A of other programs
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # numpy warns of a block of blank lines only
        return np.loadtxt(io.StringIO(block.decode("latin-1")), delimiter=",", comments=None, ndmin=2)


def _with_empty_cells(block: bytes) -> Array:
    return _by_numpy(_EMPTY_CELL.sub(b"nan", block))


def _by_cells(block: bytes, path: Path, names: Sequence[str], position: int, repairs: Repairs) -> Array:
    rows = []
    for at, line in enumerate(block.decode("utf-8", "replace").split("\n")):
        text = line.strip()
        if text.strip("\0") != text:
            repairs.skipped(ZEROS, text)
            text = text.strip("\0").strip()
        if not text or (text.startswith("#") and not is_missing(text.partition(",")[0].strip())):
            continue
        row = _row(text, len(names), repairs)
        if row is None:
            _raise_wrong_row(text, path, names, _line_number(path, position) + at + 1)
        rows.append(row)
    repairs.end_block()
    return np.array(rows, dtype=np.float64).reshape(-1, len(names))


def _row(text: str, width: int, repairs: Repairs) -> list[float] | None:
    """Numbers of a row; a comment after the row is skipped. None: it is no row."""
    cells = text.split(",")
    if len(cells) == width and all(map(_is_cell, cells)):
        return [_value(cell.strip(), repairs) for cell in cells]
    comment = _COMMENT.search(text)
    if comment is None:
        return None
    cells = text[: comment.start()].split(",")
    if len(cells) != width or not all(map(_is_cell, cells)):
        return None
    repairs.skipped(COMMENT, text[comment.start() :])
    return [_value(cell.strip(), repairs) for cell in cells]


def _is_cell(cell: str) -> bool:
    text = cell.strip()
    return _NUMBER.fullmatch(text) is not None or is_missing(text)


def _value(text: str, repairs: Repairs) -> float:
    if _NUMBER.fullmatch(text):
        return float(text.replace(MINUS, "-"))
    if text.lower().lstrip("+-") in ("inf", "infinity"):
        return float(text)  # as `write_csv` writes an infinite value
    repairs.missing(text)
    return nan


def _line_number(path: Path, position: int) -> int:
    """Number of lines before a position of the file [bytes]."""
    with path.open("rb") as file:
        return sum(file.read(min(MEGABYTE, position - at)).count(b"\n") for at in range(0, position, MEGABYTE))


def _raise_wrong_row(text: str, path: Path, names: Sequence[str], number: int) -> NoReturn:
    """Raise the error for a line that is no row."""
    cells = text.split(",")
    if len(cells) != len(names):
        raise RecordingError(f"{path}: line {number} has {len(cells)} cells, the header names {len(names)} columns")
    name, cell = next((name, cell) for name, cell in zip(names, cells, strict=True) if not _is_cell(cell))
    raise RecordingError(f"{path}: line {number}: {name} is {cell.strip()[:40]!r}, must be a number or empty")
