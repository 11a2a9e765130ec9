"""Numbers from rows of plain numbers with commas between, by pyarrow or by numpy.

Both libraries round to the nearest double, so a file gives the same numbers with and without pyarrow, which is faster.
"""

import importlib
import io
import warnings
from collections.abc import Callable, Sequence

import numpy as np

from piezod.arrays import Array

Parser = Callable[[bytes], Array]

_PLAIN = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ+-.,\r\n"
"""Characters of the rows that pyarrow parses; others may mean different things to the two libraries."""


def row_parser(width: int, used: Sequence[int], *, large: bool) -> Parser:
    """Parser of rows of `width` cells, from bytes to the used columns, shape (rows, used); ValueError for other rows.

    Parameters
    ----------
    width
        Cells per row, at least 1.
    used
        Numbers of the cells that hold numbers, increasing.
    large
        Whether the file is so large that pyarrow, if installed, saves more time than its import costs.
    """
    arrow = arrow_parser(width, used) if large and width > 1 else None

    def parse(rows: bytes) -> Array:
        if not rows.strip():
            return np.empty((0, len(used)))
        if arrow is not None:
            try:
                return arrow(rows)
            except ValueError:
                pass  # a form of number that numpy reads, or no row
        return _by_numpy(rows, width, used)

    return parse


def arrow_parser(width: int, used: Sequence[int]) -> Parser | None:
    """Parser by pyarrow, for rows of at least two cells; None if pyarrow is not installed.

    Parameters
    ----------
    width, used
        As for `row_parser`.
    """
    try:
        arrow, arrow_csv = importlib.import_module("pyarrow"), importlib.import_module("pyarrow.csv")
    except ImportError:
        return None
    names = [str(k) for k in range(width)]
    wanted = [str(k) for k in used]
    reading = arrow_csv.ReadOptions(column_names=names, block_size=2**26)
    parsing = arrow_csv.ParseOptions(quote_char=False)
    types = dict.fromkeys(wanted, arrow.float64())
    converting = arrow_csv.ConvertOptions(column_types=types, null_values=["", "nan"], include_columns=wanted)

    def by_arrow(rows: bytes) -> Array:
        if rows.translate(None, _PLAIN):
            raise ValueError
        table = arrow_csv.read_csv(arrow.BufferReader(rows), reading, parsing, converting)
        result = np.empty((table.num_rows, len(wanted)), order="F")
        for k, column in enumerate(table.columns):
            result[:, k] = column.to_numpy()
        return result

    return by_arrow


def _by_numpy(rows: bytes, width: int, used: Sequence[int]) -> Array:
    every = len(used) == width
    if not every and any(row.count(b",") != width - 1 for row in rows.split(b"\n") if row.strip()):
        raise ValueError  # numpy would take the cells of a longer row
    with warnings.catch_warnings(action="ignore", category=UserWarning):  # numpy warns of a block of blank lines only
        table = np.loadtxt(
            io.StringIO(rows.decode("latin-1")),
            delimiter=",",
            comments=None,
            ndmin=2,
            usecols=None if every else list(used),
        )
    if table.shape[1] != len(used):
        raise ValueError
    return table
