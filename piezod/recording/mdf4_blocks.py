"""The tree of blocks in an MDF 4 file, walked once before a library follows its links.

A damaged file may link a block to one before it; whoever follows such a chain never arrives. In a sound file every
block of the structure is reached exactly once. Block layout and links: ASAM MDF 4.1, as asammdf's v4_blocks reads them:

    id "##DG" | reserved 4 | length 8 | number of links 8 | links 8 each, the position of another block, 0 for none
"""

import struct
from pathlib import Path
from typing import BinaryIO

from piezod.errors import RecordingError

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
"""Which links of a block lead to its children and its next of kin; data lists (##DL, ##LD): all of them."""


def check_blocks(path: Path) -> None:
    """Walk the tree of blocks.

    Raises
    ------
    RecordingError
        The file is unfinished, or a link leads out of it or back.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(8) != b"MDF     ":
            raise RecordingError(f"{path}: is no finished MDF file; its recorder was cut off, finalise it first")
        reached = {HEADER_BLOCK}
        ahead = [HEADER_BLOCK]
        while ahead:
            for link in _children(file, ahead.pop(), size, path):
                if link in reached:
                    raise RecordingError(f"{path}: is damaged: the block at byte {link} is linked to twice")
                reached.add(link)
                ahead.append(link)


def _children(file: BinaryIO, position: int, size: int, path: Path) -> list[int]:
    file.seek(position)
    head = file.read(24)
    if len(head) < 24:
        raise RecordingError(f"{path}: is cut off: a block begins at byte {position} of {size}")
    kind, _, count = struct.unpack("<4s4x2Q", head)
    every = kind in {b"##DL", b"##LD"}
    most = count if every else 1 + max(STRUCTURE.get(kind, (-1,)))
    most = min(most, count, size // 8)
    links = struct.unpack(f"<{most}Q", file.read(8 * most).ljust(8 * most, b"\0"))
    chosen = range(most) if every else STRUCTURE.get(kind, ())
    return [links[k] for k in chosen if k < most and links[k]]
