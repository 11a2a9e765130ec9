"""The blocks of a recorder's file as they were written, without the conversion of ticks to samples."""

from contextlib import closing
from pathlib import Path

from piezod.recorder.recording_files import recording_files
from piezod.recording.formats.sqlite import BlockReader, newest_block
from piezod.recording.formats.sqlite_blocks import Block
from piezod.recording.formats.sqlite_tables import About, connect, read_about


def read_blocks(path: Path) -> tuple[About, list[Block], int]:
    """Content of the table `about`, the undamaged blocks in order, and the number of damaged ones.

    Raises
    ------
    RecordingError, sqlite3.Error, OSError
        The file is no recording or cannot be read.
    """
    with closing(connect(path)) as connection:
        about = read_about(connection, path)
        reader = BlockReader(connection, path, about.layout, newest_block(connection))
        blocks = list(reader.blocks())
        return about, blocks, reader.damaged


def begun_files(folder: Path, bench: str) -> list[Path]:
    """Files of a recorder, oldest first, without one that a kill left before its first block."""
    return [path for path in recording_files(folder, bench) if _tables(path)]


def _tables(path: Path) -> int:
    with closing(connect(path)) as connection:
        (count,) = connection.execute("SELECT count(*) FROM sqlite_schema").fetchone()
        return int(count)
