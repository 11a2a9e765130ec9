"""The two tables of a `.sqlite` recording: `about` describes it, `block` holds its rows in checked blocks.

A file is accepted only if the SQL text of both tables is exactly the text in `TABLES`. No other table is ever read.
Library: `sqlite3` of Python, with SQLite 3.33 or later. Limits: 128 MiB for a value read from a file.
"""

import json
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote

from piezod.errors import RecordingError
from piezod.recording.formats.sqlite_blocks import Block, layout_of, layout_text, pack

if TYPE_CHECKING:
    import numpy as np

SCHEMA = "piezod.recording/1"
TABLES = {
    "about": "CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "block": "CREATE TABLE block (id INTEGER PRIMARY KEY, crc INTEGER NOT NULL, data BLOB NOT NULL)",
}

MOST_VALUE_BYTES = 2**27  # size that a value read from a file may have [bytes]
WAIT_S = 5.0  # longest time that a reader waits for a lock of the writer [s]


@dataclass(frozen=True)
class About:
    """Content of the table `about`.

    Parameters
    ----------
    rows
        `ticks`: the rows are ticks of the ring log. `samples`: the rows are samples of a recording.
    metadata
        Keys and values for the user.
    session
        Identifier of the control process that wrote the ticks; empty for samples.
    origin_ns
        Row clock at the first tick of the session [ns]; 0 for samples.
    absent
        Names of columns that the device does not measure.
    """

    layout: "np.dtype[np.void]"
    rows: Literal["ticks", "samples"]
    metadata: dict[str, str]
    session: str = ""
    origin_ns: int = 0
    absent: tuple[str, ...] = field(default=())


def create_tables(connection: sqlite3.Connection, about: About) -> None:
    """Create both tables in an empty file and fill `about`, inside the caller's transaction.

    Parameters
    ----------
    connection
        Connection to an empty file, in a transaction.
    about
        Description of the recording.
    """
    for statement in TABLES.values():
        connection.execute(statement)
    values = {
        "schema": SCHEMA,
        "rows": about.rows,
        "layout": layout_text(about.layout),
        "metadata": json.dumps(about.metadata),
        "session": about.session,
        "origin_ns": str(about.origin_ns),
        "absent": json.dumps(about.absent),
    }
    connection.executemany("INSERT INTO about VALUES (?, ?)", values.items())


def append_block(connection: sqlite3.Connection, block: Block) -> None:
    """Add a block, inside the caller's transaction.

    Parameters
    ----------
    connection
        Connection to a file with both tables, in a transaction.
    block
        Rows after the last block.
    """
    connection.execute("INSERT INTO block (crc, data) VALUES (?, ?)", pack(block))


def connect(path: Path) -> sqlite3.Connection:
    """Open a file for reading, with protections against a manipulated file.

    Parameters
    ----------
    path
        SQLite file.

    Returns
    -------
    Connection that cannot write.

    Raises
    ------
    OSError
        The file does not exist.
    sqlite3.Error
        The file is no database or cannot be opened.
    """
    path.stat()  # raises the clearer error for a missing file
    try:
        return _connect_read_only(f"file:{quote(str(path))}?mode=ro")
    except sqlite3.OperationalError as error:
        cannot_write = error.sqlite_errorname.startswith(("SQLITE_CANTOPEN", "SQLITE_READONLY"))
        if not cannot_write or path.with_name(path.name + "-wal").exists():
            raise
        # A crash left the file in write-ahead mode, and this user cannot create its -shm file. Without a -wal
        # file the database is complete, so SQLite may treat it as immutable.
        return _connect_read_only(f"file:{quote(str(path))}?mode=ro&immutable=1")


def _connect_read_only(uri: str) -> sqlite3.Connection:
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=WAIT_S, check_same_thread=False)
    try:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_VALUE_BYTES)
        for pragma in ("trusted_schema = OFF", "cell_size_check = ON", "query_only = ON"):
            connection.execute(f"PRAGMA {pragma}")
        connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
    except BaseException:
        connection.close()
        raise
    return connection


def read_about(connection: sqlite3.Connection, path: Path) -> About:
    """Content of the table `about`.

    Parameters
    ----------
    connection
        Open file, from `connect`.
    path
        Path of the file, for messages.

    Raises
    ------
    RecordingError
        The file is another database or a recording of another schema, or the table's content is damaged.
    """
    tables = dict(connection.execute("SELECT name, sql FROM sqlite_schema WHERE type = 'table' LIMIT 100"))
    if not tables:
        raise RecordingError(f"{path}: has no samples: the recorder was ended before it wrote the first block")
    if any(tables.get(name) != statement for name, statement in TABLES.items()):
        raise RecordingError(f"{path}: is no recording: its tables are not those of piezod")
    values = dict(connection.execute("SELECT key, value FROM about LIMIT 100"))
    if values.get("schema") != SCHEMA:
        raise RecordingError(f"{path}: schema is {values.get('schema')!r:.60}, must be '{SCHEMA}'")
    try:
        metadata, absent = json.loads(values["metadata"]), json.loads(values["absent"])
        return About(
            layout_of(values["layout"]),
            "ticks" if values["rows"] == "ticks" else "samples",
            {str(key): str(value) for key, value in metadata.items()},
            values["session"],
            int(values["origin_ns"]),
            tuple(map(str, absent)),
        )
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise RecordingError(f"{path}: its table 'about' is damaged: {error!r:.120}") from error
