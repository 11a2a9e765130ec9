"""Reader of vectors and text in a MAT file of version 5; the reader of scipy crashes the process on damaged files.

Source of the layout: MathWorks, "MAT-File Format" (R2023b), chapter 1. A file is a header of 128 bytes and one element
per variable. An element is a tag of 8 bytes (type 4, size 4), data, and padding to a multiple of 8. For data of up to
4 bytes the tag has 4 bytes (type 2, size 2), and the data fill the rest of 8 bytes. Elements of a variable:

    type 14, matrix: flags | dimensions | name | real part | ...
    type 15, deflated: one matrix, compressed by zlib
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from piezod.arrays import Array

HEADER = 128  # size of the file's header [bytes]
MATRIX, DEFLATED = 14, 15  # types of element
HEAD = 4096  # bytes at the beginning of a variable that must hold its flags, dimensions and name
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type of element to type of its numbers."""

TEXT = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
"""Type of element to encoding of its characters."""

CLASSES = ["unknown", "cell", "struct", "object", "char", "sparse", "double", "single"]
CLASSES += ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "function", "opaque"]
NUMBERS = set(CLASSES[6:16])  # classes of full matrices of numbers
COMPLEX = 0x0800  # flag of a matrix with an imaginary part


MOST_COLUMNS = 64  # columns of a matrix that is a table; the longer side counts the samples
DEEPEST = 16  # structs within structs


@dataclass(frozen=True)
class Variable:
    """Description of a variable, from the first bytes of its element.

    Parameters
    ----------
    kind
        Entry of `CLASSES`, or `complex`.
    shape
        Dimensions of the matrix.
    position, stored
        Position of the element's data in the file and their size there [bytes].
    deflated
        Whether the data are compressed.
    size
        Size of the data after decompression [bytes].
    data
        Position of the real part in the decompressed data [bytes].
    order
        Byte order as in `struct`: `<` or `>`.
    body
        The decompressed data, for the field of a struct; None: they are read from the file.
    unit
        Unit that its struct states; empty: none.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    position: int
    stored: int
    deflated: bool
    size: int
    data: int
    order: str
    body: bytes | None = None
    unit: str = ""

    @property
    def count(self) -> int:
        """Number of values that the dimensions state."""
        return math.prod(self.shape)

    @property
    def is_vector(self) -> bool:
        """Whether the variable holds real numbers in one row or one column."""
        return self.kind in NUMBERS and len(self.shape) == 2 and 1 in self.shape

    @property
    def is_matrix(self) -> bool:
        """Whether the variable holds a table of real numbers of few columns, or few rows."""
        return self.kind in NUMBERS and len(self.shape) == 2 and 1 < min(self.shape) <= MOST_COLUMNS


def read_variables(file: BinaryIO) -> Iterator[Variable]:
    """Description of every variable of a file; the values are not read.

    Parameters
    ----------
    file
        Open file of version 5; its position changes.

    Raises
    ------
    ValueError
        The file is damaged; the message names the position.
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
                yield _parse_head(head[8:], order, position + 8, stored, length, deflated=True)
        else:
            yield _parse_head(head, order, position + 8, stored, stored, deflated=False)
        position += 8 + stored


def read_fields(file: BinaryIO, struct_: Variable) -> Iterator[tuple[str, Variable]]:
    """(path, variable) of the fields of a struct and of the structs in it, such as `out/signals(2)/values`.

    Raises
    ------
    ValueError
        The struct is damaged.
    """
    file.seek(struct_.position)
    body = file.read(struct_.stored)
    if struct_.deflated:
        body = zlib.decompressobj().decompress(body, 8 + struct_.size)[8:]
    yield from _fields(body, struct_, struct_.name, 0)


def _fields(body: bytes, struct_: Variable, path: str, depth: int) -> Iterator[tuple[str, Variable]]:
    order = struct_.order
    _, length, at = _element(body, struct_.data, order)
    _, names, at = _element(body, at, order)
    size = int.from_bytes(length[:4], "little" if order == "<" else "big")
    if not 0 < size <= 64 or depth > DEEPEST:
        raise ValueError(f"struct {path} is damaged, its field names have {size} characters")
    fields = [names[k : k + size].split(b"\0")[0].decode("latin-1") for k in range(0, len(names), size)]
    for k in range(min(struct_.count, MOST_COLUMNS)):
        element = path if struct_.count == 1 else f"{path}({k + 1})"
        for field in fields:
            _, inner, at = _element(body, at, order)
            if not inner:
                continue
            variable = _parse_head(inner, order, 0, len(inner), len(inner), deflated=False, body=inner)
            if variable.kind == "struct":
                yield from _fields(inner, variable, f"{element}/{field}", depth + 1)
            else:
                yield f"{element}/{field}", variable


def read_numbers(file: BinaryIO, variable: Variable) -> Array:
    """Values of a vector, shape (N,).

    Parameters
    ----------
    file
        Open file of version 5; its position changes.
    variable
        Numeric vector of this file, from `read_variables`.

    Raises
    ------
    ValueError
        The variable is damaged.
    """
    kind, data = _read_data(file, variable)
    values = np.frombuffer(data, dtype=np.dtype(f"{variable.order}{STORED[kind]}")) if kind in STORED else None
    if values is None or values.size != variable.count:
        raise ValueError(f"{variable.name} is damaged, its data are not {variable.count} numbers")
    return values.astype(np.float64)


def read_text(file: BinaryIO, variable: Variable) -> str:
    """Text of a character variable.

    Parameters
    ----------
    file
        Open file of version 5; its position changes.
    variable
        Character variable of this file, from `read_variables`.
    """
    kind, data = _read_data(file, variable)
    encoding = TEXT.get(kind, "latin-1")
    suffix = ("-le" if variable.order == "<" else "-be") if encoding in {"utf-16", "utf-32"} else ""
    return data.decode(encoding + suffix, "replace")


def _parse_head(
    head: bytes, order: str, position: int, stored: int, size: int, *, deflated: bool, body: bytes | None = None
) -> Variable:
    _, flags, after = _element(head, 0, order)
    _, dimensions, after = _element(head, after, order)
    _, name, after = _element(head, after, order)
    flag = struct.unpack_from(f"{order}I", flags)[0]
    kind = CLASSES[flag & 0xFF] if flag & 0xFF < len(CLASSES) else "unknown"
    shape = tuple(int(length) for length in np.frombuffer(dimensions, f"{order}i4"))
    if any(length < 0 for length in shape):
        raise ValueError(f"a variable at byte {position} has a negative dimension")
    kind = "complex" if flag & COMPLEX else kind
    return Variable(name.decode("latin-1"), kind, shape, position, stored, deflated, size, after, order, body)


def _read_data(file: BinaryIO, variable: Variable) -> tuple[int, bytes]:
    """Type and bytes of a variable's real part or of its characters."""
    if variable.body is not None:
        kind, data, _ = _element(variable.body, variable.data, variable.order)
        return kind, data
    file.seek(variable.position)
    most = variable.data + 8 + 8 * variable.count  # a value takes at most 8 bytes
    if variable.deflated:
        body = zlib.decompressobj().decompress(file.read(variable.stored), 8 + min(variable.size, most))[8:]
    else:
        body = file.read(min(variable.stored, most))
    kind, data, _ = _element(body, variable.data, variable.order)
    return kind, data


def _element(body: bytes, at: int, order: str) -> tuple[int, bytes, int]:
    """Type and data of the element at position `at`, and the position of the next one."""
    kind, size = struct.unpack_from(f"{order}2I", body, at)
    start = at + 8
    if kind >> 16:
        kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
    data = body[start : start + size]
    if len(data) < size or (start == at + 4 and size > 4):
        raise ValueError(f"element of type {kind} claims {size} bytes, {len(body) - start} are there")
    return kind, data, at + 8 + (-(-size // 8) * 8 if start == at + 8 else 0)
