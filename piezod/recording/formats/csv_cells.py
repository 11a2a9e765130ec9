"""Numbers from the cells of CSV text, by numpy or by pyarrow.

Both libraries round to the nearest double. pyarrow is faster, and it parses only blocks of plain numbers. numpy parses
every other block (comments, a leading plus, rows of unequal length). So a file gives the same numbers, or the same
error message, with and without pyarrow.
"""

import importlib
import io
import re
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.stream import Array

MEGABYTE = 2**20

Parser = Callable[[bytes], Array]

_EMPTY_CELL = re.compile(rb"(?m)(?<=,)[ \t]*(?=,|\r?$)|^[ \t]*(?=,)")
# Characters of the blocks that pyarrow parses.
_PLAIN = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ+-.,\r\n"


def parse(block: bytes, path: Path, names: Sequence[str], position: int, arrow: Parser | None) -> Array:
    """Numbers of a block of complete lines, shape (rows, columns); an empty cell is nan.

    Parameters
    ----------
    block
        Text that ends in a newline.
    path, names, position
        File, its column names, and the position of the block in it [bytes]; for messages.
    arrow
        Parser from `arrow_parser`; None: numpy parses the block.

    Raises
    ------
    RecordingError
        A cell holds no number, or a row has another number of cells than the header. The message names the first.
    """
    if arrow is not None:
        try:
            return arrow(block)
        except ValueError:
            pass  # numpy parses it below
    try:
        table = _by_numpy(block)
    except ValueError:
        filled = _EMPTY_CELL.sub(b"nan", block)
        try:
            table = _by_numpy(filled)
        except ValueError as error:
            _raise_first_wrong_cell(filled, path, names, position)
            raise RecordingError(f"{path}: after byte {position}: {error}") from error
    if table.size and table.shape[1] != len(names):
        _raise_first_wrong_cell(block, path, names, position)
    return table


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
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # numpy warns of a block of comments only
        text = io.StringIO(block.decode("latin-1"))
        return np.loadtxt(text, dtype=np.float64, delimiter=",", comments="#", ndmin=2)


def _raise_first_wrong_cell(block: bytes, path: Path, names: Sequence[str], position: int) -> None:
    """Raise the error for the first wrong line; lines are parsed one after the other."""
    with path.open("rb") as file:
        line = sum(file.read(min(MEGABYTE, position - at)).count(b"\n") for at in range(0, position, MEGABYTE))
    for number, text in enumerate(block.decode("latin-1").split("\n"), line + 1):
        row = text.partition("#")[0].strip()
        cells = row.split(",")
        if row and len(cells) != len(names):
            raise RecordingError(f"{path}: line {number} has {len(cells)} cells, the header names {len(names)} columns")
        for name, cell in zip(names, cells if row else [], strict=False):
            try:
                float(cell)
            except ValueError:
                message = f"{path}: line {number}: {name} is {cell.strip()[:40]!r}, must be a number or empty"
                raise RecordingError(message) from None
