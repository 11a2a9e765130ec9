"""The files that the recorder writes: numbered, one open at a time, the oldest given up for the newest.

    NAME-000001.sqlite, NAME-000002.sqlite, ...

A higher number is later, whatever the clock said meanwhile. The first block is committed together with the tables, so a
file holds ticks or is no recording at all.
"""

import contextlib
import os
import sqlite3
from pathlib import Path

from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import TABLES, About, append_block, create_tables

SUFFIX = ".sqlite"
BESIDE = ("", "-wal", "-shm", "-journal")
CHECKPOINT_PAGES = 256
MARGIN_BYTES = 4_000_000  # what log and last commit may add to a file that is being closed
LOCK_WAIT_S = 1.0
MODE = 0o640


class Segment:
    """One file being written; each `commit` is on the disk when it returns.

    Parameters
    ----------
    folder, bench
        Where it lies, and the bench it is named for.
    about
        What it says about itself.

    Raises
    ------
    OSError, sqlite3.Error
        It cannot be made.
    """

    def __init__(self, folder: Path, bench: str, about: About) -> None:
        self.path = _claimed(folder, bench)
        self._about: About | None = about
        try:
            self._connection = sqlite3.connect(self.path, isolation_level=None, timeout=LOCK_WAIT_S)
            try:
                self._prepare(folder)
            except BaseException:
                self._connection.close()
                raise
        except BaseException:
            remove(self.path)
            raise

    def _prepare(self, folder: Path) -> None:
        self._connection.execute("PRAGMA journal_mode = WAL")
        self._connection.execute("PRAGMA synchronous = FULL")
        self._connection.execute(f"PRAGMA wal_autocheckpoint = {CHECKPOINT_PAGES}")
        self._places = [(self.path, _identity(self.path))]
        _sync(folder, os.O_RDONLY | os.O_DIRECTORY)

    def commit(self, block: Block) -> None:
        """Put a block on the disk; it counts when this returns.

        Raises
        ------
        OSError, sqlite3.Error
            It is not there; the file takes no more.
        """
        self._connection.execute("BEGIN IMMEDIATE")
        if self._about is not None:
            create_tables(self._connection, self._about)
        append_block(self._connection, block)
        self._connection.execute("COMMIT")
        if self._about is not None:
            log = self.path.with_name(self.path.name + "-wal")
            self._places.append((log, _identity(log)))
            self._about = None
        for path, identity in self._places:
            if _identity(path) != identity:
                raise FileNotFoundError(f"{path} was replaced while it was written")

    @property
    def bytes(self) -> int:
        """What it takes on the disk, with the margin that closing it may need."""
        return size_of(self.path) + MARGIN_BYTES

    def close(self) -> None:
        """Leave one file that needs nothing beside it; where that fails, what is committed can be read all the same."""
        empty = self._about is not None
        with contextlib.suppress(sqlite3.Error):
            self._connection.execute("PRAGMA journal_mode = DELETE")
        with contextlib.suppress(sqlite3.Error):
            self._connection.close()
        if empty:
            remove(self.path)


def segments(folder: Path, bench: str) -> list[Path]:
    """Files of a bench in the order in which they were begun.

    Raises
    ------
    OSError
        The folder cannot be read.
    """
    numbered = [(number, path) for path in folder.iterdir() if (number := _number(path, bench)) is not None]
    return [path for _, path in sorted(numbered)]


def settle(paths: list[Path]) -> None:
    """Bring files that a crash left with something beside them into one; remove those without a tick."""
    for path in paths:
        with contextlib.suppress(OSError, sqlite3.Error):
            if path.stat().st_size and not path.with_name(path.name + "-wal").exists():
                continue
            with contextlib.closing(sqlite3.connect(path, isolation_level=None, timeout=0.0)) as connection:
                tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_schema")}
                connection.execute("PRAGMA journal_mode = DELETE")  # refused while another process has it open
            if not tables.issuperset(TABLES):
                remove(path)


def make_room(paths: list[Path], keep_bytes: float) -> int:
    """Remove the oldest files until the rest takes no more than `keep_bytes`; returns what the rest takes."""
    sizes = [size_of(path) for path in paths]
    total = sum(sizes)
    for path, size in zip(paths, sizes, strict=True):
        if total <= keep_bytes:
            break
        remove(path)
        total -= size
    return total


def size_of(path: Path) -> int:
    """Bytes of a file and of what lies beside it; what is not there takes none."""
    total = 0
    for suffix in BESIDE:
        with contextlib.suppress(OSError):
            total += path.with_name(path.name + suffix).stat().st_size
    return total


def sync(path: Path) -> None:
    """Bring a file that somebody else wrote, and its log, to the disk.

    Raises
    ------
    OSError
        They may not be there.
    """
    for name in (path.name, path.name + "-wal"):
        with contextlib.suppress(FileNotFoundError):
            _sync(path.with_name(name), os.O_RDONLY)


def remove(path: Path) -> None:
    """Remove a file and what lies beside it, as far as that is possible."""
    for suffix in BESIDE:
        with contextlib.suppress(OSError):
            path.with_name(path.name + suffix).unlink()


def _claimed(folder: Path, bench: str) -> Path:
    """A new, empty file with the next number."""
    existing = segments(folder, bench)
    number = (_number(existing[-1], bench) or 0) + 1 if existing else 1
    while True:
        path = folder / f"{bench}-{number:06d}{SUFFIX}"
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, MODE))
        except FileExistsError:  # by the recorder of a daemon that was killed and has not ended yet
            number += 1
            continue
        return path


def _number(path: Path, bench: str) -> int | None:
    name = path.name.removeprefix(f"{bench}-").removesuffix(SUFFIX)
    return int(name) if path.name == f"{bench}-{name}{SUFFIX}" and name.isascii() and name.isdigit() else None


def _identity(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_dev, found.st_ino


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
