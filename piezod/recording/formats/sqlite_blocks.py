"""Blocks of rows in a `.sqlite` recording: packed bytes with a checksum each, so a damaged block affects no other.

    data = row count uint32 | number of the first row uint64 | wall clock ns int64 | row clock ns int64 | deflated rows

Both clocks are read together. Their difference converts the time of a row to the time of day. The rows are
transposed before compression: first byte 0 of every row, then byte 1 of every row, and so on. Neighbouring values of a
column differ in few bytes, so the transposed bytes compress better.
"""

import json
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 2**26  # size that the rows of a block may have after decompression [bytes]
MOST_FIELDS = 4096  # fields that a row may have
FORMATS = ("<f8", "<i8", "<i4")

_HEAD = struct.Struct("<IQqq")


@dataclass(frozen=True)
class Block:
    """Consecutive rows of a recording.

    Parameters
    ----------
    rows
        Structured array, shape (n,).
    first
        Number of the first row; a writer counts all rows that it receives, without gaps.
    wall_ns, clock_ns
        Time of day (UNIX) and clock of the rows, read together [ns].
    """

    rows: NDArray[np.void]
    first: int = 0
    wall_ns: int = 0
    clock_ns: int = 0


def pack(block: Block) -> tuple[int, bytes]:
    """(checksum, data) of a block.

    Parameters
    ----------
    block
        Rows with their number and times.

    Returns
    -------
    CRC-32 of the data; head and compressed rows.
    """
    planes = np.ascontiguousarray(block.rows).view(np.uint8).reshape(block.rows.size, -1).T
    head = _HEAD.pack(block.rows.size, block.first, block.wall_ns, block.clock_ns)
    data = head + zlib.compress(planes.tobytes(), 1)
    return zlib.crc32(data), data


def unpack(checksum: object, data: object, layout: np.dtype[np.void]) -> Block | None:
    """Block from its checksum and data; None if they are damaged.

    Parameters
    ----------
    checksum, data
        Values from the file, of any type.
    """
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
    """Fields of a row as JSON: [[name, format], ...].

    Parameters
    ----------
    layout
        Structured type of a row.
    """
    return json.dumps([[name, layout[name].str] for name in layout.names or ()])


def layout_of(text: str) -> np.dtype[np.void]:
    """Fields of a row from the JSON of `layout_text`.

    Parameters
    ----------
    text
        JSON of 1 to `MOST_FIELDS` fields, each [name, format].

    Raises
    ------
    ValueError
        The text is no list of (name, format), or a format is not in `FORMATS`.
    """
    fields = json.loads(text)
    if not isinstance(fields, list) or not 0 < len(fields) <= MOST_FIELDS:
        raise ValueError(f"the layout of its rows must be a list of 1 to {MOST_FIELDS} fields")
    for field in fields:
        if not (isinstance(field, list) and len(field) == 2 and isinstance(field[0], str) and field[1] in FORMATS):
            raise ValueError(
                f"the layout of its rows has a field {field!r:.60}, must be [name, {' or '.join(FORMATS)}]"
            )
    return np.dtype([(name, kind) for name, kind in fields])
