"""Vectors and text in a MAT file of version 5, read here: scipy's reader crashes the process on damaged files.

Layout: MathWorks, "MAT-File Format" (R2023b), chapter 1. A file is a header of 128 bytes and one element a variable;
an element is a tag (type 4, bytes 4; or both in the first 4 for up to 4 bytes of data), data, and padding to 8:

    matrix (14): flags | dimensions | name | real part | ...        deflated (15): one matrix, by zlib
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from piezod.recording.formats.stream import Array

HEADER = 128
MATRIX, DEFLATED = 14, 15
HEAD = 4096
"""Bytes at the beginning of a variable in which its flags, dimensions and name must stand."""

STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type of the numbers in an element."""

TEXT = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
"""Encoding of the characters in an element."""

CLASSES = ["unknown", "cell", "struct", "object", "char", "sparse", "double", "single"]
CLASSES += ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "function", "opaque"]
NUMBERS = set(CLASSES[6:16])

COMPLEX = 0x0800


@dataclass(frozen=True)
class Variable:
    """A variable as its head describes it; `position` and `stored` are where its element lies, in bytes."""

    name: str
    kind: str
    shape: tuple[int, ...]
    position: int
    stored: int
    deflated: bool
    size: int
    data: int
    order: str

    @property
    def numbers(self) -> int:
        """How many numbers it claims to hold."""
        count = 1
        for length in self.shape:
            count *= length
        return count

    @property
    def is_vector(self) -> bool:
        """Whether it holds real numbers in one row or one column."""
        return self.kind in NUMBERS and len(self.shape) == 2 and 1 in self.shape


def variables(file: BinaryIO) -> Iterator[Variable]:
    """Every variable of a file, by its head; nothing of its data is read.

    Raises
    ------
    ValueError
        The file is damaged: where.
    """
    size = file.seek(0, 2)
    file.seek(HEADER - 2)
    order = "<" if file.read(2) == b"IM" else ">"
    position = HEADER
    while position + 8 <= size:
        file.seek(position)
        kind, stored = struct.unpack(f"{order}2I", file.read(8))
        if stored > size - position - 8 or kind not in {MATRIX, DEFLATED}:
            raise ValueError(f"element of type {kind} and {stored} bytes at byte {position} of {size}")
        head = file.read(min(stored, HEAD))
        if kind == DEFLATED:
            head = zlib.decompressobj().decompress(head, HEAD)
            inner, length = struct.unpack(f"{order}2I", head[:8])
            if inner == MATRIX:
                yield _described(head[8:], order, position + 8, stored, length, deflated=True)
        else:
            yield _described(head, order, position + 8, stored, stored, deflated=False)
        position += 8 + stored


def numbers_of(file: BinaryIO, variable: Variable) -> Array:
    """Numbers of a vector, shape (N,).

    Raises
    ------
    ValueError
        It is damaged.
    """
    kind, data = _data(file, variable)
    values = np.frombuffer(data, dtype=np.dtype(f"{variable.order}{STORED[kind]}")) if kind in STORED else None
    if values is None or values.size != variable.numbers:
        raise ValueError(f"{variable.name} is damaged, its data are not {variable.numbers} numbers")
    return values.astype(np.float64)


def text_of(file: BinaryIO, variable: Variable) -> str:
    """Characters of a row of text."""
    kind, data = _data(file, variable)
    encoding = TEXT.get(kind, "latin-1")
    suffix = ("-le" if variable.order == "<" else "-be") if encoding in {"utf-16", "utf-32"} else ""
    return data.decode(encoding + suffix, "replace")


def _described(head: bytes, order: str, position: int, stored: int, size: int, *, deflated: bool) -> Variable:
    _, flags, after = _element(head, 0, order)
    _, dimensions, after = _element(head, after, order)
    _, name, after = _element(head, after, order)
    flag = struct.unpack_from(f"{order}I", flags)[0]
    kind = CLASSES[flag & 0xFF] if flag & 0xFF < len(CLASSES) else "unknown"
    shape = tuple(int(length) for length in np.frombuffer(dimensions, f"{order}i4"))
    if any(length < 0 for length in shape):
        raise ValueError(f"a variable at byte {position} has a negative dimension")
    kind = "complex" if flag & COMPLEX else kind
    return Variable(name.decode("latin-1"), kind, shape, position, stored, deflated, size, after, order)


def _data(file: BinaryIO, variable: Variable) -> tuple[int, bytes]:
    """Type and bytes of a variable's real part, or of its characters."""
    file.seek(variable.position)
    most = variable.data + 8 + 8 * variable.numbers  # a number takes 8 bytes at most
    if variable.deflated:
        body = zlib.decompressobj().decompress(file.read(variable.stored), 8 + min(variable.size, most))[8:]
    else:
        body = file.read(min(variable.stored, most))
    kind, data, _ = _element(body, variable.data, variable.order)
    return kind, data


def _element(body: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """Type and data of the element at a position, and the position of the next."""
    kind, size = struct.unpack_from(f"{order}2I", body, at)
    start = at + 8
    if kind >> 16:
        kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
    data = body[start : start + size]
    if len(data) < size or (start == at + 4 and size > 4):
        raise ValueError(f"element of type {kind} claims {size} bytes, {len(body) - start} are there")
    return kind, data, at + 8 + (-(-size // 8) * 8 if start == at + 8 else 0)
