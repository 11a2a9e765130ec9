"""Recordings as SQLite: the format of the daemon's recorder, which writes a file while others read it.

Library: `sqlite3` of Python; no optional package. Version: `piezod.recording/1`. Limits: 2**29 numbers, 64 MiB for a
block, numeric columns only. A file that the recorder still writes is read up to the last committed block. After a crash
SQLite discards an incomplete transaction. A damaged block is skipped and counted in the metadata `damaged`.
"""

import sqlite3
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.recording.formats.access import replaced_file
from piezod.recording.formats.sqlite_blocks import Block, unpack
from piezod.recording.formats.sqlite_tables import About, append_block, connect, create_tables, read_about
from piezod.recording.formats.stream import (
    UNCHECKED_VALUES,
    RecordingStream,
    Table,
    check_claimed_size,
    chunk_ranges,
)
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.hold import HELD_ONE_SAMPLE
from piezod.recording.names import TIME, name_columns
from piezod.recording.recording import Recording
from piezod.recording.ticks import GOOD, pair_rows

WRITTEN_BLOCK_BYTES = 2**21  # size of the rows in a block that `write_sqlite` writes, before compression [bytes]
SMALLEST_BLOCK = 16  # size that a block has at least in a file [bytes]
COMMANDS = ("voltage_V", "reference_N", "planned_V")
READINGS = ("force_N", "readback_V", "temperature_C")
OTHERS = ("tick", "state", "cause", "result", "segment", "lateness_ns", "exchange_ns")
WALL = "wall_s"  # time of day [s since 1970, UTC]


def write_sqlite(recording: Recording, path: Path) -> None:
    """Write a recording without loss; an error leaves an existing file unchanged.

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
    with replaced_file(path) as temporary, closing(sqlite3.connect(temporary, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode = MEMORY")  # the temporary file needs no journal on the disk
        connection.execute("BEGIN")
        create_tables(connection, About(layout, "samples", recording.metadata))
        for start, stop in chunk_ranges(rows.size, max(1, WRITTEN_BLOCK_BYTES // layout.itemsize)):
            append_block(connection, Block(rows[start:stop], start))
        connection.execute("COMMIT")


@contextmanager
def open_sqlite(path: Path, _: TextOptions) -> Iterator[RecordingStream]:
    """Open a recording, complete or still being written; it holds the blocks that are committed now.

    Raises
    ------
    RecordingError
        The file is another database.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        last = newest_block(connection)
        metadata = dict(about.metadata) | (HELD_ONE_SAMPLE.metadata if about.rows == "ticks" else {})
        fields = _sample_names(about.absent) if about.rows == "ticks" else tuple(about.layout.names or ())
        names = name_columns(path, [(name, "") for name in fields])
        stored = dict(zip(names, fields, strict=True))

        def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
            reader = BlockReader(connection, path, about.layout, last)
            if about.rows == "ticks":
                yield from _as_samples(reader.blocks(), about.origin_ns, wanted)
            else:
                for block in reader.blocks():
                    yield {name: np.ascontiguousarray(block.rows[stored[name]], np.float64) for name in wanted}
            if reader.damaged:
                metadata["damaged"] = f"{reader.damaged} of {reader.damaged + reader.good} blocks, left out"

        yield RecordingStream(path, names, chunks, None, metadata)


def read_end(path: Path) -> tuple[About, int]:
    """Content of the table `about`, and the number of the row that would follow the last one (0: no rows).

    Parameters
    ----------
    path
        SQLite recording, complete or still being written.

    Raises
    ------
    RecordingError, sqlite3.Error, OSError
        The file is no recording or cannot be read.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        last = newest_block(connection) or 0
        block = next(iter(BlockReader(connection, path, about.layout, None).blocks(max(1, last))), None)
        return about, 0 if block is None else block.first + block.rows.size


def read_last_blocks(path: Path, most: int) -> Iterator[Block]:
    """The last `most` undamaged blocks of a recording, newest first.

    Raises
    ------
    RecordingError, OSError
        The file is no recording or cannot be read.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        last = newest_block(connection) or 0
        for number in range(last, max(0, last - most), -1):
            reader = BlockReader(connection, path, about.layout, number)
            yield from reader.blocks(number)


def newest_block(connection: sqlite3.Connection) -> int | None:
    """Number of the block committed last; 0: the file has no block; None: the page with this number is damaged.

    Parameters
    ----------
    connection
        Open recording, from `connect`.
    """
    try:
        return connection.execute("SELECT max(id) FROM block").fetchone()[0] or 0
    except sqlite3.DatabaseError:
        return None


class BlockReader:
    """Reads one block per transaction, so that it never blocks a writer.

    Parameters
    ----------
    connection, path
        Connection from `connect`, and its file.
    last
        Number of the last block to read; None: the last one in the file.

    Attributes
    ----------
    good, damaged
        Numbers of blocks that were read and skipped.
    """

    def __init__(
        self, connection: sqlite3.Connection, path: Path, layout: "np.dtype[np.void]", last: int | None
    ) -> None:
        self._connection, self._path = connection, path
        self._layout, self._last = layout, last
        self.good = self.damaged = 0

    def blocks(self, first: int = 1) -> Iterator[Block]:
        """Every undamaged block in order, from number `first` on.

        Raises
        ------
        RecordingError
            The blocks hold more numbers than a file of this size may.
        """
        number, values = first - 1, 0
        most_damaged = 1 + self._path.stat().st_size // SMALLEST_BLOCK
        while (self._last is None or number < self._last) and self.damaged < most_damaged:
            row = self._after(number)
            if row is None:
                break
            self.damaged += max(0, row[0] - number - 1)
            number = max(number + 1, row[0])
            block = unpack(row[1], row[2], self._layout)
            if block is None:
                self.damaged += 1
                continue
            self.good += 1
            values += block.rows.size * len(self._layout.names or ())
            if values > UNCHECKED_VALUES:
                check_claimed_size(self._path, values)
            yield block

    def _after(self, number: int) -> tuple[int, object, object] | None:
        """(number, checksum, data) of the next block; None at the end. A damaged page gives a block without data."""
        query = "SELECT id, crc, data FROM block WHERE id > ? ORDER BY id LIMIT 1"
        try:
            row: tuple[int, object, object] | None = self._connection.execute(query, (number,)).fetchone()
        except sqlite3.DatabaseError:
            return number + 1, 0, None
        return row


def _sample_names(absent: Collection[str]) -> tuple[str, ...]:
    """Columns of the recording.

    Parameters
    ----------
    absent
        Columns that the device lacks; they are skipped.
    """
    names = (TIME, "voltage_V", "force_N", "reference_N", "readback_V", "temperature_C", "planned_V", *OTHERS, WALL)
    return tuple(name for name in names if name not in absent)


def _as_samples(blocks: Iterable[Block], origin_ns: int, wanted: Collection[str]) -> Iterator[Table]:
    """Samples, block by block.

    Parameters
    ----------
    blocks
        Blocks in the order of their rows.
    origin_ns
        Time of the row clock at which `time_s` is 0 [ns].
    wanted
        Names among `_sample_names`.
    """
    before = None
    for block in blocks:
        commands, readings = pair_rows(block.rows, before)
        before = block.rows[-1:].copy() if block.rows.size else before
        if commands.size:
            table = _samples(commands, readings, block.wall_ns - block.clock_ns, origin_ns)
            yield {name: table[name] for name in wanted}


def _samples(commands: NDArray[np.void], readings: NDArray[np.void], to_wall_ns: int, origin_ns: int) -> Table:
    table = {name: commands[name].astype(np.float64) for name in COMMANDS}
    table |= {name: np.where(readings["result"] == GOOD, readings[name], np.nan) for name in READINGS}
    table |= {name: readings[name].astype(np.float64) for name in OTHERS}
    table[TIME] = (readings["time_ns"] - origin_ns) * 1e-9
    table[WALL] = (readings["time_ns"] + to_wall_ns) * 1e-9
    return table
