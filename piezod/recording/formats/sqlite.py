"""Recordings in SQLite: a table of what is said about them, and a table of checked blocks of rows.

A file may be read while the recorder of the daemon writes it, and after a crash: what was committed is there, SQLite
cuts off the rest, and a block that is damaged is left out and counted. Only these two tables are ever read, and only
if they are exactly what this module makes.
"""

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from urllib.parse import quote

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.sqlite_blocks import Block, layout_of, layout_text, pack, unpack
from piezod.recording.formats.stream import MANY, Source, Table, check_claim, replacing, spans
from piezod.recording.hold import HELD_ONE_SAMPLE
from piezod.recording.names import TIME, name_columns
from piezod.recording.recording import Recording
from piezod.recording.ticks import as_samples, sample_names

SCHEMA = "piezod.recording/1"
TABLES = {
    "about": "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "block": "CREATE TABLE block (id INTEGER PRIMARY KEY, crc INTEGER NOT NULL, data BLOB NOT NULL)",
}

BLOCK_BYTES = 2**21
"""Of the rows of one block of a recording that is written whole."""

LONGEST = 2**27
"""Bytes that a value read from a file may have."""

SMALLEST_BLOCK = 16
"""Bytes that a block takes at least."""

WAIT_S = 5.0
"""How long a reader waits for the writer [s]."""


@dataclass(frozen=True)
class About:
    """What a file says about itself.

    Parameters
    ----------
    layout
        Fields of a row.
    rows
        Whether they are ticks of the ring log or samples of a recording.
    metadata
        For people.
    session
        Names the control process whose ticks they are.
    origin_ns
        The row clock at the first tick of the session [ns].
    absent
        Columns that the device does not have.
    """

    layout: "np.dtype[np.void]"
    rows: Literal["ticks", "samples"]
    metadata: dict[str, str]
    session: str = ""
    origin_ns: int = 0
    absent: tuple[str, ...] = field(default=())


def create(connection: sqlite3.Connection, about: About) -> None:
    """Make the tables in an empty file, inside the caller's transaction."""
    for statement in TABLES.values():
        connection.execute(statement)
    said = {
        "schema": SCHEMA,
        "rows": about.rows,
        "layout": layout_text(about.layout),
        "metadata": json.dumps(about.metadata),
        "session": about.session,
        "origin_ns": str(about.origin_ns),
        "absent": json.dumps(about.absent),
    }
    connection.executemany("INSERT INTO about VALUES (?, ?)", said.items())


def append(connection: sqlite3.Connection, block: Block) -> None:
    """Add a block, inside the caller's transaction."""
    connection.execute("INSERT INTO block (crc, data) VALUES (?, ?)", pack(block))


def write_sqlite(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all; exact.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    columns = {TIME: recording.time_s, **recording.channels}
    layout = np.dtype([(name, "<f8") for name in columns])
    rows = np.empty(recording.time_s.size, layout)
    for name, values in columns.items():
        rows[name] = values
    with replacing(path) as temporary, closing(sqlite3.connect(temporary, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode = MEMORY")  # the file takes its place when it is whole
        connection.execute("BEGIN")
        create(connection, About(layout, "samples", recording.metadata))
        for start, stop in spans(rows.size, max(1, BLOCK_BYTES // layout.itemsize)):
            append(connection, Block(rows[start:stop], start))
        connection.execute("COMMIT")


@contextmanager
def open_sqlite(path: Path) -> Iterator[Source]:
    """Open a recording, also one that is being written: what is committed by now is what it holds.

    Raises
    ------
    RecordingError
        It is another database.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        last = newest_block(connection)
        metadata = dict(about.metadata) | (HELD_ONE_SAMPLE.metadata if about.rows == "ticks" else {})
        fields = sample_names(about.absent) if about.rows == "ticks" else tuple(about.layout.names or ())
        names = name_columns(path, [(name, "") for name in fields])
        stored = dict(zip(names, fields, strict=True))

        def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
            reader = BlockReader(connection, path, about.layout, last)
            if about.rows == "ticks":
                yield from as_samples(reader.blocks(), about.origin_ns, wanted)
            else:
                for block in reader.blocks():
                    yield {name: np.ascontiguousarray(block.rows[stored[name]], np.float64) for name in wanted}
            if reader.damaged:
                metadata["damaged"] = f"{reader.damaged} of {reader.damaged + reader.good} blocks, left out"

        yield Source(path, names, chunks, None, metadata)


def connect(path: Path) -> sqlite3.Connection:
    """Open a file to read it; nothing in it is believed.

    Raises
    ------
    sqlite3.Error
        It cannot be opened.
    """
    path.stat()  # so that a missing file is called missing
    try:
        return _connected(f"file:{quote(str(path))}?mode=ro")
    except sqlite3.OperationalError as error:
        cannot_write = error.sqlite_errorname.startswith(("SQLITE_CANTOPEN", "SQLITE_READONLY"))
        if not cannot_write or path.with_name(path.name + "-wal").exists():
            raise
        # Left by a crash and all of it in the file, in a folder where nothing may be made beside it.
        return _connected(f"file:{quote(str(path))}?mode=ro&immutable=1")


def _connected(uri: str) -> sqlite3.Connection:
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=WAIT_S, check_same_thread=False)
    try:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
        for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "query_only = ON"):
            connection.execute(f"PRAGMA {pragma}")
        connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


def read_about(connection: sqlite3.Connection, path: Path) -> About:
    """What a file says about itself.

    Raises
    ------
    RecordingError
        It is another database, or of another version.
    """
    tables = dict(connection.execute("SELECT name, sql FROM sqlite_schema WHERE type = 'table' LIMIT 100"))
    if any(tables.get(name) != statement for name, statement in TABLES.items()):
        raise RecordingError(f"{path}: is no recording: its tables are not those of piezod")
    said = dict(connection.execute("SELECT key, value FROM about LIMIT 100"))
    if said.get("schema") != SCHEMA:
        raise RecordingError(f"{path}: schema is {said.get('schema')!r:.60}, must be '{SCHEMA}'")
    try:
        metadata, absent = json.loads(said["metadata"]), json.loads(said["absent"])
        return About(
            layout_of(said["layout"]),
            "ticks" if said["rows"] == "ticks" else "samples",
            {str(key): str(value) for key, value in metadata.items()},
            said["session"],
            int(said["origin_ns"]),
            tuple(map(str, absent)),
        )
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: what it says about itself is damaged: {error!r:.120}") from error


def newest_block(connection: sqlite3.Connection) -> int | None:
    """Number of the block committed last, 0 for none, None where that page is damaged."""
    try:
        return connection.execute("SELECT max(id) FROM block").fetchone()[0] or 0
    except sqlite3.DatabaseError:
        return None


class BlockReader:
    """Reads block after block, each in a transaction of its own, so that a writer is never held up.

    Parameters
    ----------
    connection, path
        Of `connect`.
    layout
        Fields of a row.
    last
        Number of the last block; None: to the end.

    Attributes
    ----------
    good, damaged
        Blocks that were read, and that were left out.
    """

    def __init__(
        self, connection: sqlite3.Connection, path: Path, layout: "np.dtype[np.void]", last: int | None
    ) -> None:
        self._connection, self._path = connection, path
        self._layout, self._last = layout, last
        self.good = self.damaged = 0

    def blocks(self, first: int = 1) -> Iterator[Block]:
        """Every block that is sound, in order, from one of them on.

        Raises
        ------
        RecordingError
            They hold more numbers than a recording may.
        """
        at, values = first - 1, 0
        patience = 1 + self._path.stat().st_size // SMALLEST_BLOCK
        while (self._last is None or at < self._last) and self.damaged < patience:
            found = self._after(at)
            if found is None:
                break
            self.damaged += max(0, found[0] - at - 1)
            at = max(at + 1, found[0])
            block = unpack(found[1], found[2], self._layout)
            if block is None:
                self.damaged += 1
                continue
            self.good += 1
            values += block.rows.size * len(self._layout.names or ())
            if values > MANY:
                check_claim(self._path, values)
            yield block

    def _after(self, at: int) -> tuple[int, object, object] | None:
        """The next block as (number, checksum, data); one without data where its page is damaged; None at the end."""
        query = "SELECT id, crc, data FROM block WHERE id > ? ORDER BY id LIMIT 1"
        try:
            found: tuple[int, object, object] | None = self._connection.execute(query, (at,)).fetchone()
        except sqlite3.DatabaseError:
            return at + 1, 0, None
        return found


def read_ticks(path: Path) -> tuple[About, list[Block], int]:
    """What a recorder wrote, as it was written: about, its sound blocks, and the number of damaged ones.

    Raises
    ------
    RecordingError, sqlite3.Error, OSError
        It is no recording, or cannot be read.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        reader = BlockReader(connection, path, about.layout, newest_block(connection))
        blocks = list(reader.blocks())
        return about, blocks, reader.damaged


def read_end(path: Path) -> tuple[About, int]:
    """What a file says about itself, and the number of the row after its last one (0: it holds none).

    Raises
    ------
    RecordingError, sqlite3.Error, OSError
        It is no recording, or cannot be read.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        last = newest_block(connection) or 0
        block = next(iter(BlockReader(connection, path, about.layout, None).blocks(max(1, last))), None)
        return about, 0 if block is None else block.first + block.rows.size
