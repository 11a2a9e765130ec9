"""What a worker is at, in memory that outlives it: the case's number, when it began, its input, and what it took."""

import mmap
import time
from pathlib import Path

from tests.fuzz.mutation import LARGEST

# Whole numbers of 8 bytes, each written in one piece: the parent reads at any moment, struct would show it zeros.
_CASES, _BEGUN_NS, _SIZE, _PEAK_KIB, _GROWN_KIB, _DESCRIPTORS, _ACCEPTED = range(7)
_WORD, _WORDS = 8, 8
_DATA = _WORD * _WORDS


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
        self._view = memoryview(self._memory)
        self._words = self._view[:_DATA].cast("q")

    def begin(self, data: bytes) -> None:
        """Write down the case before it is tried."""
        words, kept = self._words, data[:LARGEST]
        self._memory[_DATA : _DATA + len(kept)] = kept
        words[_SIZE] = len(kept)
        words[_CASES] += 1
        words[_BEGUN_NS] = time.monotonic_ns()

    def idle(self) -> None:
        """Nothing is being tried: what takes long now is no case."""
        self._words[_BEGUN_NS] = 0

    def take(self, peak_KiB: int, grown_KiB: int, descriptors: int, accepted: int) -> None:
        """Write down what the cases took so far, and how many the parser accepted."""
        self._words[_PEAK_KIB], self._words[_GROWN_KIB] = peak_KiB, grown_KiB
        self._words[_DESCRIPTORS], self._words[_ACCEPTED] = descriptors, accepted

    @property
    def took(self) -> tuple[float, float, int, int]:
        """Peak and growth of the resident memory [MiB], descriptors more than before, cases accepted."""
        words = self._words
        return words[_PEAK_KIB] / 1024, words[_GROWN_KIB] / 1024, words[_DESCRIPTORS], words[_ACCEPTED]

    @property
    def cases(self) -> int:
        """How many were begun."""
        return self._words[_CASES]

    @property
    def age_s(self) -> float:
        """How long the present case has been tried [s]; 0 when there is none."""
        begun_ns = self._words[_BEGUN_NS]
        return 1e-9 * (time.monotonic_ns() - begun_ns) if begun_ns else 0.0

    @property
    def data(self) -> bytes:
        """Its input."""
        return bytes(self._view[_DATA : _DATA + self._words[_SIZE]])

    def close(self) -> None:
        """Let go of the memory."""
        self._words.release()
        self._view.release()
        self._memory.close()
