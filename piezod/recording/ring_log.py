"""The ring log: a file in shared memory that holds the latest ticks; one process writes, any number of processes read.

    file       = header | capacity places | counters
    header     = magic, 8 bytes | size of a place | capacity | number of rows written so far, each uint64
    place      = row | number of the row, from 1, uint64
    counters   = 64 counts of the writer, each uint64

The first 8 counters hold how many values of a live reference passed each result of their check; those behind them hold
the leaky counts of the interlocks (`piezod/control/leaky_count.py`). A reader may ignore them.

The control loop is the only writer. It writes the row, then increases the count. A reader copies rows and reads the
count again. Rows that were overwritten in the meantime are dropped and counted. The writer takes no lock, so no reader
can delay a tick.

Both sides use the file by position (`pwrite`, `pread`) and never touch mapped memory: a file that somebody truncates
would end each process that touches its mapping. `RingReader.is_broken` detects this case, and `RingLog.restore`
makes the file again. A place that lost its row, or a part of it, does not end with the number of that row.
"""

import contextlib
import mmap
import os
import struct
import weakref
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config.regular_file import open_regular
from piezod.config.run_time_files import FILE_MODE, NO_SPACE, group_id, is_own_file, set_access
from piezod.errors import ConfigurationError, PiezodError, TemporaryError, UnreachableError

MAGIC = b"PIEZRNG1"
_OWN = MAGIC[:-1]  # also of another version
_KEY = "daemon.ring_log"
COUNTERS = 64
_COUNTERS_BYTES = 8 * COUNTERS
_HEAD = struct.Struct("<8sQQQ")
_COUNT_AT = 24
MOST_BYTES = 1 << 34  # largest ring log [byte]; more than any memory
_PLACE = struct.Struct("<qqddddddqqiiiiQ")

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
_PLACE_DTYPE = np.dtype([("row", ROW_DTYPE), ("number", "<u8")])


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
    lost
        Number of rows that could not be written.

    Raises
    ------
    TemporaryError
        There is no space for the file.
    ConfigurationError
        The file cannot be created, or is not piezod's own.
    """

    def __init__(self, path: Path | None, capacity: int, group: str | None = None) -> None:
        self._path, self._capacity, self._group = path, capacity, group
        self._row = bytearray(_PLACE.size)
        self._count = memoryview(bytearray(8)).cast("Q")
        counts = bytearray(_COUNTERS_BYTES)
        self.counters = memoryview(counts).cast("Q")
        self._counts, self._written_counts = counts, bytes(counts)
        self._descriptor, self._pinned = self._made()
        self._rows = 0
        self.lost = 0

    def _made(self) -> tuple[int, mmap.mmap]:
        """Make the file, and a mapping that only keeps its pages in memory."""
        size = _HEAD.size + self._capacity * _PLACE.size + _COUNTERS_BYTES
        head = _HEAD.pack(MAGIC, _PLACE.size, self._capacity, 0)
        try:
            descriptor = _open_file(self._path, size, head, self._group)
        except OSError as error:
            raise _file_error(self._path, size, error) from error
        return descriptor, mmap.mmap(descriptor, size, mmap.MAP_SHARED | mmap.MAP_POPULATE)

    def append(self, *row: float) -> None:
        """Write a row; a failure is counted in `lost`.

        Parameters
        ----------
        *row
            Values in the order of `ROW_DTYPE`.
        """
        descriptor, place = self._descriptor, _HEAD.size + self._rows % self._capacity * _PLACE.size
        self._rows += 1
        _PLACE.pack_into(self._row, 0, *row, self._rows)
        self._count[0] = self._rows
        try:
            os.pwrite(descriptor, self._row, place)
            os.pwrite(descriptor, self._count, _COUNT_AT)
            if self._counts != self._written_counts:
                self._written_counts = bytes(self._counts)
                os.pwrite(descriptor, self._counts, _HEAD.size + self._capacity * _PLACE.size)
        except OSError:  # the file was truncated, and its file system is full
            self.lost += 1

    def restore(self) -> None:
        """Make the file again after it was removed or truncated; its rows count from 0 again.

        Raises
        ------
        TemporaryError, ConfigurationError
            As for a new ring log; the former file stays in use.
        """
        former = self._descriptor, self._pinned
        with contextlib.suppress(OSError):  # a truncated file has lost its mark, but is known by its number
            if self._path is not None and os.path.samestat(os.fstat(former[0]), self._path.lstat()):
                self._path.unlink()
        self._descriptor, self._pinned = self._made()
        self._rows, self._written_counts = 0, b""
        former[1].close()
        os.close(former[0])

    def close(self) -> None:
        """Close the file, which stays for its readers. A second call has no effect."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            self._pinned.close()
            os.close(descriptor)


def remove_ring_log(path: Path) -> None:
    """Remove a ring log; no effect on any other file."""
    with contextlib.suppress(OSError, ConfigurationError):
        if is_own_file(path, _KEY, _OWN):
            path.unlink()


def _open_file(path: Path | None, size: int, head: bytes, group: str | None) -> int:
    """Create and fill the file; an own file at the path is replaced, and an incomplete one is removed."""
    if path is None:
        descriptor = os.memfd_create("ring log", os.MFD_CLOEXEC)
    else:
        gid = group_id(group, "daemon.socket_group")
        if is_own_file(path, _KEY, _OWN):
            path.unlink()
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, FILE_MODE)
    try:
        os.pwrite(descriptor, head, 0)  # magic number, written first
        if path is not None:
            set_access(descriptor, FILE_MODE, gid)
        os.posix_fallocate(descriptor, 0, size)
    except BaseException:
        os.close(descriptor)
        if path is not None:
            path.unlink(missing_ok=True)
        raise
    return descriptor


def _file_error(path: Path | None, size: int, error: OSError) -> TemporaryError | ConfigurationError:
    text = f"{_KEY}: {path} cannot be created: {error.strerror or error}"
    if error.errno in NO_SPACE:
        return TemporaryError(f"{text}; it needs {size / 1e6:.1f} MB: free them, or lower daemon.ring_seconds")
    return ConfigurationError(f"{text}; name another path")


class RingReader:
    """Reader of a ring log; several readers are independent of each other.

    Parameters
    ----------
    first
        Number of the first row to read; the writer's first row is number 0.

    Attributes
    ----------
    dropped
        Number of rows that were overwritten or lost before they were read.

    Raises
    ------
    UnreachableError
        The file does not exist or is no ring log of this version.
    """

    def __init__(self, path: Path, first: int = 0) -> None:
        self._path = path
        try:
            with open_regular(path, MOST_BYTES) as file:
                self._descriptor = os.dup(file.fileno())
        except PiezodError as error:
            raise UnreachableError(f"{path}: no ring log to read: is the daemon running?") from error
        weakref.finalize(self, os.close, self._descriptor)
        head = os.pread(self._descriptor, _HEAD.size, 0)
        if len(head) < _HEAD.size:
            raise UnreachableError(f"{path}: no ring log to read: is the daemon running?")
        magic, row_size, self._capacity, _ = _HEAD.unpack(head)
        if magic != MAGIC or row_size != _PLACE.size:
            raise UnreachableError(f"{path}: not a ring log of this version; restart the daemon")
        self._next = first
        self.dropped = 0

    @property
    def is_broken(self) -> bool:
        """Whether the file was removed, replaced or truncated, so that other processes cannot read it any more."""
        size = _HEAD.size + self._capacity * _PLACE.size
        try:
            own, present = os.fstat(self._descriptor), self._path.stat()
        except OSError:
            return True
        head = os.pread(self._descriptor, len(MAGIC), 0)
        return not os.path.samestat(own, present) or own.st_size < size or head != MAGIC

    @property
    def counters(self) -> tuple[int, ...]:
        """Counters of the writer; empty for a writer of an earlier version."""
        place = _HEAD.size + self._capacity * _PLACE.size
        content = os.pread(self._descriptor, _COUNTERS_BYTES, place)
        return struct.unpack(f"<{COUNTERS}Q", content) if len(content) == _COUNTERS_BYTES else ()

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
        places = self._copied(first, written)
        numbers = first + 1 + np.arange(places.size, dtype=np.uint64)
        # without rows that the writer may overwrite, or that a truncated file has lost
        good = (numbers + self._capacity > self._written() + 1) & (places["number"] == numbers)
        fresh: NDArray[np.void] = places["row"][good]
        self.dropped += max(written - self._next, 0) - fresh.size
        self._next = written
        return fresh

    def _copied(self, first: int, end: int) -> NDArray[np.void]:
        """Places of the rows `first` to `end`, as far as the file has them."""
        begin, count = first % self._capacity, max(end - first, 0)
        parts = [(begin, min(count, self._capacity - begin)), (0, max(count - (self._capacity - begin), 0))]
        content = b"".join(
            os.pread(self._descriptor, size * _PLACE.size, _HEAD.size + at * _PLACE.size) for at, size in parts if size
        )
        return np.frombuffer(content[: len(content) // _PLACE.size * _PLACE.size], _PLACE_DTYPE)

    def _written(self) -> int:
        content = os.pread(self._descriptor, 8, _COUNT_AT)
        written = int.from_bytes(content, "little") if len(content) == 8 else 0
        return max(written, self._next)  # a truncated file has lost its count
