"""Recordings as CSV: `#` lines of metadata, one header row, `time_s` first, every column `name_unit`.

An empty cell is a missing sample. Files are read in blocks of whole lines; a block at a time is in memory.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from typing import BinaryIO

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.csv_cells import arrow_parser, parse
from piezod.recording.formats.stream import MOST_VALUES, Source, Table, foreign, replacing, whole
from piezod.recording.names import TIME, channel_name, name_columns
from piezod.recording.recording import Recording

BLOCK = 2**22
"""Bytes parsed at once: numbers of rows that fit the cache, calls too few to count."""

LARGE = 2**24
"""Bytes above which pyarrow is worth its import."""


def read_csv(path: Path) -> Recording:
    """Read a CSV recording, whatever its suffix.

    Raises
    ------
    RecordingError
        One line: the file, the line and column, and what is wrong with it.
    """
    with foreign(path, "read"), open_csv(path) as source:
        return whole(source)


@contextmanager
def open_csv(path: Path) -> Iterator[Source]:
    """Open a CSV file: its header is read, its rows are not yet.

    Raises
    ------
    RecordingError
        The header is none.
    """
    with path.open("rb") as file:
        metadata, names = _read_head(file, path)
        arrow = arrow_parser(len(names)) if path.stat().st_size > LARGE else None

        def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
            at = [names.index(name) for name in wanted]
            values = 0
            for position, block in _blocks(file, path):
                table = parse(block, path, names, position, arrow)
                values += table.size
                if values > MOST_VALUES:
                    raise RecordingError(f"{path}: has more than {MOST_VALUES:.3g} numbers; split it")
                if table.size:
                    yield {name: np.ascontiguousarray(table[:, k]) for name, k in zip(wanted, at, strict=True)}

        yield Source(path, names, chunks, None, metadata)


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all: time to the nanosecond, values to nine digits, missing ones as nan.

    Raises
    ------
    RecordingError
        The file cannot be written, a name would break the header, or samples are closer than nanoseconds.
    """
    names = (TIME, *recording.channels)
    bad = [name for name in names if not name.strip() or name != name.strip() or set(name) & set(",#\r\n")]
    if bad:
        raise RecordingError(f"{path}: cannot be written: {bad[0]!r} is no column name")
    if (np.diff(np.round(recording.time_s, 9)) <= 0).any():
        raise RecordingError(f"{path}: cannot be written: samples lie closer than 1 ns, CSV keeps nanoseconds")
    row = ",".join(["%.9f", *["%.9g"] * len(recording.channels)]) + "\n"
    table = [recording.time_s, *recording.channels.values()]
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        for key, value in recording.metadata.items():
            file.write(f"# {' '.join(key.split())}: {' '.join(value.split())}\n")
        file.write(",".join(names) + "\n")
        for start in range(0, recording.time_s.size, 2**14):
            block = np.column_stack([column[start : start + 2**14] for column in table])
            file.write("".join(repeat(row, len(block))) % tuple(block.ravel().tolist()))


def _read_head(file: BinaryIO, path: Path) -> tuple[dict[str, str], tuple[str, ...]]:
    """Metadata and column names; leaves the file at the first row."""
    metadata: dict[str, str] = {}
    for number in range(1, 10_000):
        raw = file.readline(BLOCK)
        if not raw or len(raw) == BLOCK:
            break
        try:
            line = raw.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            raise RecordingError(f"{path}: cannot be read: line {number} is no text: {error}") from error
        if line.startswith("#"):
            key, _, value = line[1:].partition(":")
            metadata[key.strip()] = value.strip()
        elif line.strip():
            return metadata, _header(line, path)
    raise RecordingError(f"{path}: is empty, must hold a header row and samples")


def _header(line: str, path: Path) -> tuple[str, ...]:
    cells = line.split(",")
    if channel_name(cells[0]) != TIME:
        raise RecordingError(f"{path}: first column is {cells[0].strip()[:40]!r}, must be {TIME}")
    return name_columns(path, [(cell, "") for cell in cells])


def _blocks(file: BinaryIO, path: Path) -> Iterator[tuple[int, bytes]]:
    """Whole lines, some megabytes at a time, each with its position in the file."""
    position = file.tell()
    rest = b""
    while read := file.read(BLOCK):
        end = read.rfind(b"\n") + 1
        if end:
            block = b"".join([rest, memoryview(read)[:end]])
            yield position, block
            position += len(block)
        rest = read[end:] if end else rest + read
        if len(rest) > BLOCK:
            raise RecordingError(f"{path}: has a line longer than {BLOCK} bytes, at byte {position}")
    if rest:
        yield position, rest + b"\n"
