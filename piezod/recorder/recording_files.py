"""The files of the recorder, written in the recorder process.

    NAME-000001.sqlite, NAME-000002.sqlite, ...

Each file has a number; a higher number is later, at any setting of the clock. One file is open at a time. The oldest
files are removed when the folder reaches its limit. The tables are committed together with the first block, so every
valid file contains ticks.
"""

import contextlib
import os
import sqlite3
import sys
from pathlib import Path

from piezod.config.regular_file import open_regular
from piezod.config.run_time_files import FILE_MODE
from piezod.errors import ConfigurationError
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import TABLES, About, append_block, create_tables
from piezod.runtime import databases, descriptors

SUFFIX = ".sqlite"
PARTS = ("", "-wal", "-shm", "-journal")  # suffixes of a file and of its companion files of SQLite
CHECKPOINT_PAGES = 256
MARGIN_BYTES = 4_000_000  # largest size that the write-ahead log and the last commit add while a file is closed [byte]
LOCK_WAIT_S = 1.0
MARK = 0x70696564  # `application_id` in the header of every file: "pied"
PAGE = 4096  # of SQLite, which the first commit exceeds [byte]
MARK_AT = 68  # place of it in the header of a file of SQLite [byte]


class RecordingFile:
    """The file that is being written.

    Parameters
    ----------
    folder, bench
        Folder of the file, and name of the bench.
    about
        Description that the file contains.

    Raises
    ------
    OSError, sqlite3.Error
        The file cannot be created.
    """

    def __init__(self, folder: Path, bench: str, about: About) -> None:
        self.path = _new_file(folder, bench)
        self._about: About | None = about
        try:
            self._connection = databases.connect(self.path, isolation_level=None, timeout=LOCK_WAIT_S)
            try:
                self._prepare(folder)
            except BaseException:
                self._connection.close()
                raise
        except BaseException:
            remove(self.path)
            raise

    def _prepare(self, folder: Path) -> None:
        self._connection.execute(f"PRAGMA application_id = {MARK}")  # before the log, so that it stands in the file
        self._connection.execute("PRAGMA journal_mode = WAL")
        self._connection.execute("PRAGMA synchronous = FULL")
        self._connection.execute(f"PRAGMA wal_autocheckpoint = {CHECKPOINT_PAGES}")
        self._places = [(self.path, _identity(self.path))]
        _sync(folder, os.O_RDONLY | os.O_DIRECTORY)

    def commit(self, block: Block) -> None:
        """Write a block to the disk; the block is on the disk when this returns.

        Parameters
        ----------
        block
            Block after the last committed block.

        Raises
        ------
        OSError, sqlite3.Error
            The block may not be on the disk; the file must not be used further.
        """
        self._connection.execute("BEGIN IMMEDIATE")
        if self._about is not None:
            create_tables(self._connection, self._about)
        append_block(self._connection, block)
        self._connection.execute("COMMIT")
        if self._about is not None:
            write_ahead_log = self.path.with_name(self.path.name + "-wal")
            self._places.append((write_ahead_log, _identity(write_ahead_log)))
            self._about = None
        for path, identity in self._places:
            if _identity(path) != identity:
                raise FileNotFoundError(f"{path} was replaced while it was written")

    @property
    def bytes(self) -> int:
        """Size on the disk with the margin for closing it [byte]."""
        return size_bytes(self.path) + MARGIN_BYTES

    def close(self) -> None:
        """Join everything into one file. If that fails, the committed blocks stay readable. Remove an empty file."""
        empty = self._about is not None
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA journal_mode = DELETE")
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()
        if empty:
            remove(self.path)


def recording_files(folder: Path, bench: str) -> list[Path]:
    """List the files of a bench, oldest first.

    Parameters
    ----------
    folder, bench
        Folder of the files, and name of the bench.

    Raises
    ------
    OSError
        The folder cannot be read.
    """
    numbered = [(number, path) for path in folder.iterdir() if (number := _number(path, bench)) is not None]
    return [path for _, path in sorted(numbered)]


def tidy_files(paths: list[Path]) -> None:
    """Join files that a crash left in several parts, and remove files without ticks; foreign files stay as they are."""
    for path in paths:
        with contextlib.suppress(OSError, sqlite3.Error):
            if not is_own(path) or (path.stat().st_size > PAGE and not path.with_name(path.name + "-wal").exists()):
                continue
            with contextlib.closing(databases.connect(path, isolation_level=None, timeout=0.0)) as connection:
                tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_schema")}
                connection.execute("PRAGMA journal_mode = DELETE")  # refused while another process has it open
            if not tables:
                remove(path)


def make_room(paths: list[Path], keep_bytes: float) -> int:
    """Remove the oldest recordings until the rest is small enough; a file with other content stays.

    Parameters
    ----------
    paths
        Files, oldest first.
    keep_bytes
        Largest size of the rest [byte].

    Returns
    -------
    int
        Size of the rest [byte].
    """
    paths = [path for path in paths if is_own(path)]
    sizes = [size_bytes(path) for path in paths]
    total = sum(sizes)
    for path, size in zip(paths, sizes, strict=True):
        if total <= keep_bytes:
            break
        remove(path)
        total -= size
    return total


def size_bytes(path: Path) -> int:
    """Size of a file and of its parts [byte]; a missing part counts 0."""
    total = 0
    for suffix in PARTS:
        with contextlib.suppress(OSError):
            total += path.with_name(path.name + suffix).stat().st_size
    return total


def sync(path: Path) -> None:
    """Write a file of another process, and its write-ahead log, from the page cache to the disk.

    Raises
    ------
    OSError
        They may not be on the disk.
    """
    for name in (path.name, path.name + "-wal"):
        with contextlib.suppress(FileNotFoundError):
            _sync(path.with_name(name), os.O_RDONLY)


def remove(path: Path) -> None:
    """Remove a file and its parts, as far as that is possible."""
    for suffix in PARTS:
        with contextlib.suppress(OSError):
            path.with_name(path.name + suffix).unlink()


def remove_folder(folder: Path, bench: str) -> None:
    """Remove the files of a bench and their folder, which stays if it holds something else."""
    with contextlib.suppress(OSError):
        for path in recording_files(folder, bench):
            remove(path)
        folder.rmdir()


def _new_file(folder: Path, bench: str) -> Path:
    """Create an empty file with the next number."""
    existing = recording_files(folder, bench)
    number = (_number(existing[-1], bench) or 0) + 1 if existing else 1
    while True:
        path = folder / f"{bench}-{number:06d}{SUFFIX}"
        try:
            descriptor = descriptors.open_file(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, FILE_MODE)
        except FileExistsError:  # created by the recorder of a killed daemon that still runs
            number += 1
            continue
        try:
            os.fchmod(descriptor, FILE_MODE)  # SQLite gives this mode to its further files
        finally:
            descriptors.close(descriptor)
        return path


def is_own(path: Path) -> bool:
    """Whether the recorder made a file: it carries the mark or the tables, or a crash emptied it."""
    with contextlib.suppress(OSError, ConfigurationError):
        with open_regular(path, sys.maxsize) as file:
            head = file.read(PAGE)
        is_marked = head.startswith(b"SQLite format 3\0") and head[MARK_AT : MARK_AT + 4] == MARK.to_bytes(4)
        return is_marked or not head.strip(b"\0") or all(one.encode() in head for one in TABLES.values())
    return False


def _number(path: Path, bench: str) -> int | None:
    name = path.name.removeprefix(f"{bench}-").removesuffix(SUFFIX)
    return int(name) if path.name == f"{bench}-{name}{SUFFIX}" and name.isascii() and name.isdigit() else None


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino


def _sync(path: Path, flags: int) -> None:
    descriptor = descriptors.open_file(path, flags | os.O_CLOEXEC)
    try:
        descriptors.fsync(descriptor)
    finally:
        descriptors.close(descriptor)
