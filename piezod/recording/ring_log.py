"""The ring log: every tick in shared memory, written without waiting, read by whoever likes.

    file = header | capacity rows
    header = magic (8 bytes) | row size | capacity | rows written so far, each uint64

The control loop is the only writer: it packs the row, then advances the count. A reader copies rows and looks at the
count again; what was overwritten meanwhile is dropped and counted. No lock, no system call, no other process can
slow a tick.
"""

import mmap
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.errors import ConfigurationError, UnreachableError

MAGIC = b"PIEZRNG1"
_HEAD = struct.Struct("<8sQQQ")
_COUNT = slice(24, 32)
_ROW = struct.Struct("<qqddddddqqiiii")

ROW_DTYPE = np.dtype(
    [
        ("tick", "<i8"),
        ("time_ns", "<i8"),
        ("reference_N", "<f8"),
        ("planned_V", "<f8"),
        ("voltage_V", "<f8"),
        ("force_N", "<f8"),
        ("readback_V", "<f8"),
        ("temperature_C", "<f8"),
        ("lateness_ns", "<i8"),
        ("exchange_ns", "<i8"),
        ("state", "<i4"),
        ("result", "<i4"),
        ("segment", "<i4"),
        ("cause", "<i4"),
    ]
)


class RingLog:
    """The writer's end.

    Parameters
    ----------
    path
        File to create, best on a memory file system.
    capacity
        Rows kept.

    Raises
    ------
    ConfigurationError
        The file cannot be created.
    """

    def __init__(self, path: Path, capacity: int) -> None:
        self._capacity = capacity
        self._rows = 0
        size = _HEAD.size + capacity * _ROW.size
        try:
            path.unlink(missing_ok=True)
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o640)
        except OSError as error:
            raise ConfigurationError(f"daemon.ring_log: {path} cannot be created: {error.strerror}") from error
        try:
            os.posix_fallocate(descriptor, 0, size)
            flags = mmap.MAP_SHARED | mmap.MAP_POPULATE  # no page is touched for the first time in a tick
            self._memory = mmap.mmap(descriptor, size, flags)
        finally:
            os.close(descriptor)
        _HEAD.pack_into(self._memory, 0, MAGIC, _ROW.size, capacity, 0)
        self._count = _count_of(self._memory)

    def append(self, *row: float) -> None:
        """Write one row: the fields of `ROW_DTYPE` in their order."""
        _ROW.pack_into(self._memory, _HEAD.size + self._rows % self._capacity * _ROW.size, *row)
        self._rows += 1
        self._count[0] = self._rows

    def close(self) -> None:
        """Let go of the memory; the file stays for its readers. May be called twice."""
        self._count.release()
        self._memory.close()


class RingReader:
    """A reader's end; several may follow one ring.

    Parameters
    ----------
    path
        The ring's file.
    first
        Number of the row to begin with, counted from the first that the writer wrote; what was overwritten before it
        is read counts as dropped.

    Raises
    ------
    UnreachableError
        There is no ring of this version there.
    """

    def __init__(self, path: Path, first: int = 0) -> None:
        try:
            with path.open("rb") as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise UnreachableError(f"{path}: no ring log to read: is the daemon running?") from error
        magic, row_size, self._capacity, _ = _HEAD.unpack_from(self._memory, 0)
        if magic != MAGIC or row_size != _ROW.size:
            raise UnreachableError(f"{path}: not a ring log of this version")
        self._count = _count_of(self._memory)
        self._table = np.frombuffer(self._memory, ROW_DTYPE, self._capacity, _HEAD.size)
        self._next = first
        self.dropped = 0

    @property
    def next(self) -> int:
        """Number of the row that is read next, from 0."""
        return self._next

    @property
    def waiting(self) -> int:
        """Rows that were written and not read, overwritten or not."""
        return max(0, self._written() - self._next)

    def seek(self, row: int) -> None:
        """Go on with this row: one that was read and could not be kept."""
        self._next = row

    def read(self, most: int | None = None) -> NDArray[np.void]:
        """Rows written since the last call, oldest first; what was overwritten in between is counted in `dropped`.

        Parameters
        ----------
        most
            Rows that are wanted at once; the rest is for the next call. None: all.
        """
        written = self._written()
        first = max(self._next, written - self._capacity + 1)
        if most is not None:
            written = min(written, first + most)
        rows = self._table[np.arange(first, written) % self._capacity]
        overwritten = min(max(0, self._written() - self._capacity + 1 - first), rows.size)
        self.dropped += first - self._next + overwritten
        self._next = written
        fresh: NDArray[np.void] = rows[overwritten:]
        return fresh

    def _written(self) -> int:
        return int(self._count[0])


def _count_of(memory: mmap.mmap) -> memoryview:
    """The count as one machine word: `struct` would clear it first, and another process could read that."""
    return memoryview(memory)[_COUNT].cast("Q")
