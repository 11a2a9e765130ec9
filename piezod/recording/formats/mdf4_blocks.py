"""The tree of blocks in an MDF 4 file, walked once before a library follows its links.

A damaged file may link a block to one before it; whoever follows such a chain never arrives. In a sound file every
block of the structure is reached exactly once. Block layout and links: ASAM MDF 4.1, as asammdf's v4_blocks reads them:

    id "##DG" | reserved 4 | length 8 | number of links 8 | links 8 each, the position of another block, 0 for none
"""

import struct
from pathlib import Path
from typing import BinaryIO

from piezod.errors import RecordingError
from piezod.recording.formats.stream import check_claim

HEADER_BLOCK = 64
"""Position of the first block."""

STRUCTURE = {
    b"##HD": (0, 1, 2, 3, 4),  # data groups, history, hierarchy, attachments, events
    b"##DG": (0, 1, 2),  # next, channel groups, data
    b"##CG": (0, 1, 4),  # next, channels, sample reductions
    b"##CN": (0, 1),  # next, composition
    b"##CA": (0,),
    b"##CH": (0, 1),
    b"##FH": (0,),
    b"##AT": (0,),
    b"##EV": (0,),
    b"##SR": (0, 1),
    b"##HL": (0,),
}
"""Which links of a block lead to its children and its next of kin."""

GROUPS = {(b"##HD", 0): b"##DG", (b"##DG", 0): b"##DG", (b"##DG", 1): b"##CG", (b"##CG", 0): b"##CG"}
"""What must stand at the end of a link of the first levels."""

LISTS = {b"##DL", b"##LD"}
"""Blocks all of whose links lead to children."""


COMMENT = 5
"""The link of the first block to its comment."""


def check_blocks(path: Path) -> None:
    """Walk the tree of blocks.

    Raises
    ------
    RecordingError
        The file is unfinished, a link leads out of it or back, or a block claims to be larger than it can be.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER_BLOCK).ljust(HEADER_BLOCK, b"\0")
        head[:24].decode()  # refuses as asammdf does, which then fails to clean up after itself
        if not head.startswith(b"MDF     ") or any(head[60:64]):  # id_file, flags of what is left to do
            raise RecordingError(f"{path}: is no finished MDF file; its recorder was cut off, finalise it first")
        _check_header(file, path, size)
        reached = {HEADER_BLOCK}
        ahead = [HEADER_BLOCK]
        while ahead:
            for link in _children(file, ahead.pop(), size, path):
                if link in reached:
                    raise RecordingError(f"{path}: is damaged: the block at byte {link} is linked to twice")
                reached.add(link)
                ahead.append(link)


def _check_header(file: BinaryIO, path: Path, size: int) -> None:
    """The first block and its comment."""
    kind, links = _block(file, HEADER_BLOCK, size, path)
    comment = links[COMMENT] if len(links) > COMMENT else 0
    if kind != b"##HD" or (comment and _block(file, comment, size, path)[0] not in {b"##TX", b"##MD"}):
        raise RecordingError(f"{path}: is damaged: its first block or its comment is none")


def _children(file: BinaryIO, position: int, size: int, path: Path) -> list[int]:
    kind, links = _block(file, position, size, path)
    if kind == b"##CG":
        file.seek(position + 24 + 8 * len(links) + 8)
        cycles, record, invalid = struct.unpack("<Q8x2I", file.read(24).ljust(24, b"\0"))
        check_claim(path, cycles * (record + invalid) // 8)
    if kind == b"##DZ":
        original = struct.unpack("<8xQ", file.read(16).ljust(16, b"\0"))[0]
        check_claim(path, original // 8)
    chosen = range(len(links)) if kind in LISTS else STRUCTURE.get(kind, ())
    if len(links) <= max(chosen, default=-1):
        raise RecordingError(f"{path}: is damaged: the block at byte {position} has {len(links)} links")
    children = [(k, links[k]) for k in chosen if links[k]]
    for k, link in children:
        wanted = GROUPS.get((kind, k))
        if wanted and _block(file, link, size, path)[0] != wanted:
            raise RecordingError(f"{path}: is damaged: at byte {link} is no block {wanted.decode()}")
    return [link for _, link in children]


def _block(file: BinaryIO, position: int, size: int, path: Path) -> tuple[bytes, tuple[int, ...]]:
    """Kind and links of a block; the file is left behind the links."""
    file.seek(position)
    kind, length, count = struct.unpack("<4s4x2Q", file.read(24).ljust(24, b"\0"))
    if length > size - position or 24 + 8 * count > length:
        raise RecordingError(
            f"{path}: is damaged or cut off: a block at byte {position} of {size} claims {length} bytes"
        )
    return kind, struct.unpack(f"<{count}Q", file.read(8 * count))
