"""The ring log: a file in shared memory that holds the latest ticks; one process writes, any number of processes read.

    file       = header | capacity rows | counters
    header     = magic, 8 bytes | row size | capacity | number of rows written so far, each uint64
    counters   = 8 counts of the writer, each uint64

The counters hold how many values of a live reference passed each result of their check. A reader may ignore them.

The control loop is the only writer. It writes the row, then increases the count. A reader copies rows and reads the
count again. Rows that were overwritten in the meantime are dropped and counted. The writer takes no lock and makes no
system call, so no reader can delay a tick.
"""

import contextlib
import mmap
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config.run_time_files import FILE_MODE, NO_SPACE, group_id, is_own_file, set_access
from piezod.errors import ConfigurationError, TemporaryError, UnreachableError

MAGIC = b"PIEZRNG1"
_OWN = MAGIC[:-1]  # also of another version
_KEY = "daemon.ring_log"
COUNTERS = 8
_COUNTERS_BYTES = 8 * COUNTERS
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
        File to create, preferably on a file system in memory; None: memory of this process, without a file.
    capacity
        Number of rows in the file, at least 1.
    group
        Group that may read the file; None: the group of this process.

    Attributes
    ----------
    counters
        Counters of the writer, shape (`COUNTERS`,).

    Raises
    ------
    TemporaryError
        There is no space for the file.
    ConfigurationError
        The file cannot be created, or is not piezod's own.
    """

    def __init__(self, path: Path | None, capacity: int, group: str | None = None) -> None:
        self._capacity = capacity
        self._rows = 0
        rows_end = _HEAD.size + capacity * _ROW.size
        size = rows_end + _COUNTERS_BYTES
        head = _HEAD.pack(MAGIC, _ROW.size, capacity, 0)
        try:
            self._memory = mmap.mmap(-1, size) if path is None else _mapped_file(path, size, head, group)
        except OSError as error:
            raise _file_error(path, size, error) from error
        _HEAD.pack_into(self._memory, 0, MAGIC, _ROW.size, capacity, 0)
        self._count = _count_of(self._memory)
        self.counters = memoryview(self._memory)[rows_end:size].cast("Q")

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
        self.counters.release()
        self._count.release()
        self._memory.close()


def remove_ring_log(path: Path) -> None:
    """Remove a ring log; no effect on any other file.

    Parameters
    ----------
    path
        Path of the ring log.
    """
    with contextlib.suppress(OSError, ConfigurationError):
        if is_own_file(path, _KEY, _OWN):
            path.unlink()


def _mapped_file(path: Path, size: int, head: bytes, group: str | None) -> mmap.mmap:
    """Create the file and map it; an own file at the path is replaced, and an incomplete one is removed."""
    gid = group_id(group, "daemon.socket_group")
    if is_own_file(path, _KEY, _OWN):
        path.unlink()
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, FILE_MODE)
    try:
        os.pwrite(descriptor, head, 0)  # first of all: the mark of an own file
        set_access(descriptor, FILE_MODE, gid)
        os.posix_fallocate(descriptor, 0, size)
        return mmap.mmap(descriptor, size, mmap.MAP_SHARED | mmap.MAP_POPULATE)  # all pages now, not in a tick
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    finally:
        os.close(descriptor)


def _file_error(path: Path | None, size: int, error: OSError) -> TemporaryError | ConfigurationError:
    text = f"{_KEY}: {path} cannot be created: {error.strerror or error}"
    if error.errno in NO_SPACE:
        return TemporaryError(f"{text}; it needs {size / 1e6:.1f} MB: free them, or lower daemon.ring_seconds")
    return ConfigurationError(f"{text}; name another path")


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
        self._counters = memoryview(self._memory)[_HEAD.size + self._capacity * _ROW.size :]
        self._next = first
        self.dropped = 0

    @property
    def counters(self) -> tuple[int, ...]:
        """Counters of the writer; empty for a writer of an earlier version."""
        return tuple(self._counters[:_COUNTERS_BYTES].cast("Q")) if len(self._counters) >= _COUNTERS_BYTES else ()

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
