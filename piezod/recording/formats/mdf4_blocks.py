"""Check of the tree of blocks in an MDF 4 file, before asammdf follows its links.

In a damaged file a block may link to an earlier one, and a reader that follows this chain loops without end. In a sound
file each block of the structure is reached exactly once. Source of the layout: ASAM MDF 4.1, as in the module
`asammdf.blocks.v4_blocks`. A block is (sizes in bytes):

    id 4, such as "##DG" | reserved 4 | length 8 | number of links 8 | links 8 each | data

A link is the position of another block in the file, or 0 for none.
"""

import struct
from pathlib import Path
from typing import BinaryIO

from piezod.errors import RecordingError
from piezod.recording.formats.stream import check_claimed_size

HEADER_BLOCK = 64  # position of the first block
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
"""Indices of the links that lead to the children of a block and to its next sibling."""

GROUPS = {(b"##HD", 0): b"##DG", (b"##DG", 0): b"##DG", (b"##DG", 1): b"##CG", (b"##CG", 0): b"##CG"}
"""(id of a block, index of a link) to the id of the block that it must lead to, for the upper levels."""

LISTS = {b"##DL", b"##LD"}
"""Blocks of which every link leads to a child."""

COMMENT = 5  # index of the link from the first block to its comment


def check_blocks(path: Path) -> None:
    """Check every block of the structure.

    Parameters
    ----------
    path
        MDF 4 file.

    Raises
    ------
    RecordingError
        The file is not finalised, or a link leads out of the file or to a block that was reached before.
        Also if a block claims a size that is impossible in this file.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(HEADER_BLOCK).ljust(HEADER_BLOCK, b"\0")
        head[:24].decode()  # same error as in asammdf, which would leave its file open
        if not head.startswith(b"MDF     ") or any(head[60:64]):  # id_file, flags of unfinished parts
            raise RecordingError(f"{path}: is no finished MDF file, its recorder was interrupted; finalise it first")
        _check_header(file, path, size)
        reached = {HEADER_BLOCK}
        pending = [HEADER_BLOCK]
        while pending:
            for link in _children(file, pending.pop(), size, path):
                if link in reached:
                    raise RecordingError(f"{path}: is damaged: the block at byte {link} is linked to twice")
                reached.add(link)
                pending.append(link)


def _check_header(file: BinaryIO, path: Path, size: int) -> None:
    """Check the first block and its comment."""
    kind, links = _block(file, HEADER_BLOCK, size, path)
    comment = links[COMMENT] if len(links) > COMMENT else 0
    if kind != b"##HD" or (comment and _block(file, comment, size, path)[0] not in {b"##TX", b"##MD"}):
        raise RecordingError(f"{path}: is damaged: its first block or its comment is invalid")


def _children(file: BinaryIO, position: int, size: int, path: Path) -> list[int]:
    """Positions of the children and the next sibling of a block."""
    kind, links = _block(file, position, size, path)
    if kind == b"##CG":
        file.seek(position + 24 + 8 * len(links) + 8)
        cycles, record, invalid = struct.unpack("<Q8x2I", file.read(24).ljust(24, b"\0"))
        check_claimed_size(path, cycles * (record + invalid) // 8)
    if kind == b"##DZ":
        original = struct.unpack("<8xQ", file.read(16).ljust(16, b"\0"))[0]
        check_claimed_size(path, original // 8)
    chosen = range(len(links)) if kind in LISTS else STRUCTURE.get(kind, ())
    if len(links) <= max(chosen, default=-1):
        raise RecordingError(f"{path}: is damaged: the block at byte {position} has {len(links)} links")
    children = [(k, links[k]) for k in chosen if links[k]]
    for k, link in children:
        wanted = GROUPS.get((kind, k))
        if wanted and _block(file, link, size, path)[0] != wanted:
            raise RecordingError(f"{path}: is damaged: the block at byte {link} must be {wanted.decode()}")
    return [link for _, link in children]


def _block(file: BinaryIO, position: int, size: int, path: Path) -> tuple[bytes, tuple[int, ...]]:
    """Id and links of a block; the file's position is then the end of the links."""
    file.seek(position)
    kind, length, count = struct.unpack("<4s4x2Q", file.read(24).ljust(24, b"\0"))
    if length > size - position or 24 + 8 * count > length:
        raise RecordingError(
            f"{path}: is damaged or cut off: a block at byte {position} of {size} claims {length} bytes"
        )
    return kind, struct.unpack(f"<{count}Q", file.read(8 * count))
