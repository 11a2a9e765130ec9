"""Progress of a worker in shared memory that survives its crash: case number, start time, input, resources."""

import mmap
import time
from pathlib import Path

from tests.fuzz.mutation import LARGEST

# Integers of 8 bytes, each written atomically, since the parent reads at any time; struct.pack_into is not atomic.
_CASES, _BEGUN_NS, _SIZE, _PEAK_KIB, _GROWN_KIB, _DESCRIPTORS, _ACCEPTED = range(7)
_WORD, _WORDS = 8, 8
_DATA = _WORD * _WORDS


class SharedProgress:
    """A file in shared memory, written by the worker and read by its parent.

    Parameters
    ----------
    path
        Path of the file; created if it is missing.
    """

    def __init__(self, path: Path) -> None:
        size = _DATA + LARGEST
        with path.open("r+b" if path.exists() else "w+b") as file:
            file.truncate(size)
            self._memory = mmap.mmap(file.fileno(), size)
        self._view = memoryview(self._memory)
        self._words = self._view[:_DATA].cast("q")

    def begin(self, data: bytes) -> None:
        """Store a case before it is tried."""
        words, stored = self._words, data[:LARGEST]
        self._memory[_DATA : _DATA + len(stored)] = stored
        words[_SIZE] = len(stored)
        words[_CASES] += 1
        words[_BEGUN_NS] = time.monotonic_ns()

    def idle(self) -> None:
        """Mark that no case is running."""
        self._words[_BEGUN_NS] = 0

    def take(self, peak_KiB: int, grown_KiB: int, descriptors: int, accepted: int) -> None:
        """Store the resources used so far and the number of accepted cases."""
        self._words[_PEAK_KIB], self._words[_GROWN_KIB] = peak_KiB, grown_KiB
        self._words[_DESCRIPTORS], self._words[_ACCEPTED] = descriptors, accepted

    @property
    def took(self) -> tuple[float, float, int, int]:
        """Peak and growth of the resident memory [MiB], additional descriptors, accepted cases."""
        words = self._words
        return words[_PEAK_KIB] / 1024, words[_GROWN_KIB] / 1024, words[_DESCRIPTORS], words[_ACCEPTED]

    @property
    def cases(self) -> int:
        """Number of started cases."""
        return self._words[_CASES]

    @property
    def age_s(self) -> float:
        """Duration of the present case [s]; 0 without one."""
        begun_ns = self._words[_BEGUN_NS]
        return 1e-9 * (time.monotonic_ns() - begun_ns) if begun_ns else 0.0

    @property
    def data(self) -> bytes:
        """Input of the present case."""
        return bytes(self._view[_DATA : _DATA + self._words[_SIZE]])

    def close(self) -> None:
        """Release the memory."""
        self._words.release()
        self._view.release()
        self._memory.close()
