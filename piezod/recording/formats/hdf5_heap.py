"""Check of the global heaps of an HDF5 file, where text is stored, before the HDF5 library reads them.

On some damaged heaps the library loops without end. Source of the layout: The HDF Group, "HDF5 File Format
Specification Version 3.0", section III.E. A global heap (sizes in bytes) is:

    heap = "GCOL" 4 | version 1 | reserved 3 | size 8 | objects.

    object = index 2 | references 2 | reserved 4 | size 8 | data, padded to a multiple of 8

An object of index 0 is the free space after the last one.
"""

import struct
from pathlib import Path
from typing import BinaryIO

from piezod.errors import RecordingError

SIGNATURE = b"GCOL\x01\0\0\0"
BLOCK = 2**22  # bytes that are searched together
OBJECT = struct.Struct("<H6xQ")


def check_heaps(path: Path) -> None:
    """Check every global heap of a file.

    Parameters
    ----------
    path
        HDF5 file.

    Raises
    ------
    RecordingError
        An object reaches beyond the end of its heap, a heap beyond the end of the file, or a size is 0.
    """
    with path.open("rb") as file:
        position = 0
        while block := file.read(BLOCK):
            at = block.find(SIGNATURE)
            while at >= 0:
                _check_heap(file, position + at, path)
                at = block.find(SIGNATURE, at + 1)
            position += max(len(block) - len(SIGNATURE) + 1, 1)
            file.seek(position)


def _check_heap(file: BinaryIO, position: int, path: Path) -> None:
    file.seek(position + 8)
    size = int.from_bytes(file.read(8), "little")
    if position + size > file.seek(0, 2):
        raise RecordingError(f"{path}: is damaged: text at byte {position} claims {size} bytes")
    file.seek(position + 16)
    heap = file.read(min(size, BLOCK) - 16) if size > 16 else b""
    at = 0
    while len(heap) - at >= OBJECT.size:
        index, length = OBJECT.unpack_from(heap, at)
        step = length if index == 0 else OBJECT.size + (length + 7) // 8 * 8
        if step < OBJECT.size or at + step > size - 16:
            raise RecordingError(f"{path}: is damaged: text at byte {position + 16 + at} claims {length} bytes")
        at += step
