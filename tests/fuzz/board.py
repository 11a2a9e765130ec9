"""What a worker is at, in memory that outlives it: the case's number, when it began, its input, and what it took."""

import mmap
import struct
import time
from pathlib import Path

from tests.fuzz.mutation import LARGEST

_HEAD = struct.Struct("<QdQ")  # cases begun, begun at (monotonic, the same for all processes) [s], bytes of the input
_TOOK = struct.Struct("<ddqQ")  # peak of the resident memory, its growth [MiB], descriptors more, cases accepted
_DATA = _HEAD.size + _TOOK.size


class Board:
    """A file in shared memory, written by the worker and read by its parent.

    Parameters
    ----------
    path
        The file; made if it is not there.
    """

    def __init__(self, path: Path) -> None:
        size = _DATA + LARGEST
        with path.open("r+b" if path.exists() else "w+b") as file:
            file.truncate(size)
            self._memory = mmap.mmap(file.fileno(), size)

    def begin(self, data: bytes) -> None:
        """Write down the case before it is tried."""
        number, _, _ = _HEAD.unpack_from(self._memory)
        kept = data[:LARGEST]
        self._memory[_DATA : _DATA + len(kept)] = kept
        _HEAD.pack_into(self._memory, 0, number + 1, time.monotonic(), len(kept))

    def idle(self) -> None:
        """Nothing is being tried: what takes long now is no case."""
        number, _, size = _HEAD.unpack_from(self._memory)
        _HEAD.pack_into(self._memory, 0, number, float("inf"), size)

    def take(self, peak_MiB: float, grown_MiB: float, descriptors: int, accepted: int) -> None:
        """Write down what the cases took so far, and how many the parser accepted."""
        _TOOK.pack_into(self._memory, _HEAD.size, peak_MiB, grown_MiB, descriptors, accepted)

    @property
    def took(self) -> tuple[float, float, int, int]:
        """Peak and growth of the resident memory [MiB], descriptors more than before, cases accepted."""
        return _TOOK.unpack_from(self._memory, _HEAD.size)

    @property
    def cases(self) -> int:
        """How many were begun."""
        return int(_HEAD.unpack_from(self._memory)[0])

    @property
    def age_s(self) -> float:
        """How long the present case has been tried [s]; negative when there is none."""
        return time.monotonic() - float(_HEAD.unpack_from(self._memory)[1])

    @property
    def data(self) -> bytes:
        """Its input."""
        size = int(_HEAD.unpack_from(self._memory)[2])
        return bytes(self._memory[_DATA : _DATA + size])

    def close(self) -> None:
        """Let go of the memory."""
        self._memory.close()
