"""The ring log: a file in shared memory that holds the latest ticks; one process writes, any number of processes read.

    file = header | capacity rows
    header = magic, 8 bytes | row size | capacity | number of rows written so far, each uint64

The control loop is the only writer. It writes the row, then increases the count. A reader copies rows and reads the
count again. Rows that were overwritten in the meantime are dropped and counted. The writer takes no lock and makes no
system call, so no reader can delay a tick.
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
    """Writer of the ring log.

    Parameters
    ----------
    path
        File to create, preferably on a file system in memory.
    capacity
        Number of rows in the file, at least 1.

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
            flags = mmap.MAP_SHARED | mmap.MAP_POPULATE  # all pages are mapped now, not in a tick
            self._memory = mmap.mmap(descriptor, size, flags)
        finally:
            os.close(descriptor)
        _HEAD.pack_into(self._memory, 0, MAGIC, _ROW.size, capacity, 0)
        self._count = _count_of(self._memory)

    def append(self, *row: float) -> None:
        """Write one row.

        Parameters
        ----------
        *row
            Values in the order of `ROW_DTYPE`.
        """
        _ROW.pack_into(self._memory, _HEAD.size + self._rows % self._capacity * _ROW.size, *row)
        self._rows += 1
        self._count[0] = self._rows

    def close(self) -> None:
        """Unmap the memory; the file stays for its readers. A second call has no effect."""
        self._count.release()
        self._memory.close()


class RingReader:
    """Reader of a ring log; several readers are independent of each other.

    Parameters
    ----------
    path
        File of the ring log.
    first
        Number of the first row to read; the writer's first row is number 0.

    Attributes
    ----------
    dropped
        Number of rows that were overwritten before they were read.

    Raises
    ------
    UnreachableError
        The file does not exist or is no ring log of this version.
    """

    def __init__(self, path: Path, first: int = 0) -> None:
        try:
            with path.open("rb") as file:
                self._memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            raise UnreachableError(f"{path}: no ring log to read: is the daemon running?") from error
        magic, row_size, self._capacity, _ = _HEAD.unpack_from(self._memory, 0)
        if magic != MAGIC or row_size != _ROW.size:
            raise UnreachableError(f"{path}: not a ring log of this version; restart the daemon")
        self._count = _count_of(self._memory)
        self._table = np.frombuffer(self._memory, ROW_DTYPE, self._capacity, _HEAD.size)
        self._next = first
        self.dropped = 0

    @property
    def next(self) -> int:
        """Number of the row that is read next; the writer's first row is number 0."""
        return self._next

    @property
    def waiting(self) -> int:
        """Number of rows that are written and not yet read, whether overwritten or not."""
        return max(0, self._written() - self._next)

    def seek(self, row: int) -> None:
        """Continue with row number `row`, for example to read a row again."""
        self._next = row

    def read(self, most: int | None = None) -> NDArray[np.void]:
        """Rows since the last call, oldest first; overwritten rows are counted in `dropped`.

        Parameters
        ----------
        most
            Largest number of rows to return, at least 1; later calls return the others. None: all.

        Returns
        -------
        NDArray
            Structured array of `ROW_DTYPE`, shape (n,).
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
    """The count of rows as one machine word; `struct` would write it in two steps that another process can see."""
    return memoryview(memory)[_COUNT].cast("Q")
