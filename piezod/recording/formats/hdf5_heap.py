"""The heaps of text in an HDF5 file, walked before the HDF5 library does: on a damaged one it never comes back.

Layout: HDF5 File Format Specification 3.0, III.E. A global heap is "GCOL" | version 1, reserved 3 | size 8, then
objects: index 2 | references 2 | reserved 4 | size 8 | data padded to 8; index 0 is the free space behind the last.
"""

import struct
from pathlib import Path
from typing import BinaryIO

from piezod.errors import RecordingError

SIGNATURE = b"GCOL\x01\0\0\0"
BLOCK = 2**22
OBJECT = struct.Struct("<H6xQ")


def check_heaps(path: Path) -> None:
    """Walk every global heap of a file.

    Raises
    ------
    RecordingError
        An object of one reaches beyond its end, or has no size.
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
    heap = file.read(min(size, BLOCK) - 16) if size > 16 else b""
    at = 0
    while len(heap) - at >= OBJECT.size:
        index, length = OBJECT.unpack_from(heap, at)
        step = length if index == 0 else OBJECT.size + (length + 7) // 8 * 8
        if step < OBJECT.size or at + step > size - 16:
            raise RecordingError(f"{path}: is damaged: text at byte {position + 16 + at} claims {length} bytes")
        at += step
