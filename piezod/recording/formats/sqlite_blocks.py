"""Blocks of rows as they lie in a `.sqlite` recording: checked on their own, so that a damaged one costs no other.

    data = rows uint32 | number of the first row uint64 | wall clock ns int64 | row clock ns int64 | deflated bytes

The two clocks were read at one moment: their difference turns the time of a row into the time of day. Before
deflating, the first bytes of all rows are laid one after the other, then the second bytes, and so on: neighbours in a
column differ in few of their bytes.
"""

import json
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 2**26
"""What one block may unfold to."""

MOST_FIELDS = 4096
FORMATS = ("<f8", "<i8", "<i4")

_HEAD = struct.Struct("<IQqq")


@dataclass(frozen=True)
class Block:
    """Rows that were written together.

    Parameters
    ----------
    rows
        Structured, shape (n,).
    first
        Number of the first of them, gapless over everything that one writer was given.
    wall_ns, clock_ns
        Time of day (UNIX) and the clock of the rows, read at one moment [ns].
    """

    rows: NDArray[np.void]
    first: int = 0
    wall_ns: int = 0
    clock_ns: int = 0


def pack(block: Block) -> tuple[int, bytes]:
    """(checksum, data) of a block."""
    planes = np.ascontiguousarray(block.rows).view(np.uint8).reshape(block.rows.size, -1).T
    head = _HEAD.pack(block.rows.size, block.first, block.wall_ns, block.clock_ns)
    data = head + zlib.compress(planes.tobytes(), 1)
    return zlib.crc32(data), data


def unpack(checksum: object, data: object, layout: np.dtype[np.void]) -> Block | None:
    """Rows of a block, or None where it is not what was packed."""
    if not isinstance(data, bytes) or len(data) < _HEAD.size or zlib.crc32(data) != checksum:
        return None
    count, first, wall_ns, clock_ns = _HEAD.unpack_from(data)
    size = count * layout.itemsize
    if not 0 < size <= MOST_BYTES:
        return None
    try:
        planes = zlib.decompressobj().decompress(memoryview(data)[_HEAD.size :], size + 1)
    except zlib.error:
        return None
    if len(planes) != size:
        return None
    rows = np.ascontiguousarray(np.frombuffer(planes, np.uint8).reshape(-1, count).T).view(layout).reshape(count)
    return Block(rows, first, wall_ns, clock_ns)


def layout_text(layout: np.dtype[np.void]) -> str:
    """A row's fields as JSON: [[name, format], ...]."""
    return json.dumps([[name, layout[name].str] for name in layout.names or ()])


def layout_of(text: str) -> np.dtype[np.void]:
    """Fields from what `layout_text` wrote.

    Raises
    ------
    ValueError
        It is something else.
    """
    fields = json.loads(text)
    if not isinstance(fields, list) or not 0 < len(fields) <= MOST_FIELDS:
        raise ValueError("the layout of its rows is no list of fields")
    for field in fields:
        if not (isinstance(field, list) and len(field) == 2 and isinstance(field[0], str) and field[1] in FORMATS):
            raise ValueError(f"the layout of its rows has a field {field!r:.60}")
    return np.dtype([(name, kind) for name, kind in fields])
