"""Times of the phases of a tick, in shared memory: the loop writes six stamps a tick, the daemon makes histograms.

    phases   read: the reference. plan: compensator. exchange: limits, wire, commit. check: interlocks. log: ring log
    memory   number of ticks written | CAPACITY rows of six stamps [ns]; all int64

A tick costs one write of a row, without a lock or a system call. Only ticks that write a voltage are written. A reader
that is late by more than `CAPACITY` ticks misses the oldest.
"""

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

PHASES = ("read", "plan", "exchange", "check", "log")
CAPACITY = 4096
CELLS = 1 + CAPACITY * (len(PHASES) + 1)  # number of int64 values in the shared memory
_ROW = struct.Struct("<6q")
_HEAD_BYTES = 8


class PhaseTimes:
    """Writer of the stamps.

    Parameters
    ----------
    cells
        Memory of `CELLS` int64 values, such as `multiprocessing.RawArray`; None: memory of this process.
    """

    __slots__ = ("_count", "_memory", "_ticks")

    def __init__(self, cells: Any = None) -> None:  # noqa: ANN401  # any object with the buffer protocol
        self._memory = memoryview(bytearray(8 * CELLS) if cells is None else cells).cast("B")
        self._count = self._memory[:_HEAD_BYTES].cast("q")
        self._ticks = 0

    def add_tick(self, *stamps_ns: int) -> None:
        """Write one tick.

        Parameters
        ----------
        *stamps_ns
            Begin of the tick, then the end of each of the `PHASES` [ns].
        """
        _ROW.pack_into(self._memory, _HEAD_BYTES + self._ticks % CAPACITY * _ROW.size, *stamps_ns)
        self._ticks += 1
        self._count[0] = self._ticks

    @property
    def memory(self) -> memoryview:
        """Memory of the stamps, for a reader in the same process."""
        return self._memory


class PhaseReader:
    """Reader of the stamps.

    Parameters
    ----------
    cells
        Memory that the writer uses.
    """

    def __init__(self, cells: Any) -> None:  # noqa: ANN401  # any object with the buffer protocol
        memory = memoryview(cells).cast("B")
        self._count = memory[:_HEAD_BYTES].cast("q")
        self._table = np.frombuffer(memory, np.int64, CELLS - 1, _HEAD_BYTES).reshape(CAPACITY, len(PHASES) + 1)
        self._next = 0

    def read(self) -> NDArray[np.int64]:
        """Durations of the phases since the last call [ns], shape (N, 5), oldest first."""
        written = self._count[0]
        first = max(self._next, written - CAPACITY + 1)
        rows = self._table[np.arange(first, written) % CAPACITY]
        overwritten = min(max(0, self._count[0] - CAPACITY + 1 - first), len(rows))
        self._next = written
        durations: NDArray[np.int64] = np.diff(rows[overwritten:], axis=1)
        return durations
