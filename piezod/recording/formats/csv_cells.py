"""Cells of CSV text to numbers, quickly: numpy, or pyarrow where it is installed and gives the same.

Both round to the nearest double. What pyarrow declines (comments, a leading plus, ragged rows) numpy decides, so that
a file is accepted, or refused with the same words, whether pyarrow is there or not.
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
_PLAIN = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ+-.,\r\n"


def parse(block: bytes, path: Path, names: Sequence[str], position: int, arrow: Parser | None) -> Array:
    """Numbers of a block of whole lines, shape (rows, columns); an empty cell is nan.

    Parameters
    ----------
    block
        Text, ends in a newline.
    path, names, position
        For messages: the file, its columns, the bytes before this block.
    arrow
        What `arrow_parser` made.

    Raises
    ------
    RecordingError
        The line and column of the first cell that is no number, or the first line of another length.
    """
    if arrow is not None:
        try:
            return arrow(block)
        except ValueError:
            pass  # numpy decides
    try:
        table = _by_numpy(block)
    except ValueError:
        filled = _EMPTY_CELL.sub(b"nan", block)
        try:
            table = _by_numpy(filled)
        except ValueError as error:
            _refuse(filled, path, names, position)
            raise RecordingError(f"{path}: after byte {position}: {error}") from error
    if table.size and table.shape[1] != len(names):
        _refuse(block, path, names, position)
    return table


def arrow_parser(columns: int) -> Parser | None:
    """Make a parser by pyarrow for rows of that many columns; None where pyarrow is not installed."""
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
            raise ValueError  # signs on which the two might differ
        table = arrow_csv.read_csv(arrow.BufferReader(block), reading, parsing, converting)
        result = np.empty((table.num_rows, columns))
        for k, column in enumerate(table.columns):
            result[:, k] = column.to_numpy()
        return result

    return by_arrow


def _by_numpy(block: bytes) -> Array:
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # a block of comments holds no numbers
        text = io.StringIO(block.decode("latin-1"))
        return np.loadtxt(text, dtype=np.float64, delimiter=",", comments="#", ndmin=2)


def _refuse(block: bytes, path: Path, names: Sequence[str], position: int) -> None:
    """Say which line is wrong, looking at one after the other."""
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
                what = f"{path}: line {number}: {name} is {cell.strip()[:40]!r}, must be a number or empty"
                raise RecordingError(what) from None
