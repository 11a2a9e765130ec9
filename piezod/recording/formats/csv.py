"""Recordings as CSV: lines of metadata that begin with `#`, one header row, then one row per sample.

The first column is `time_s`, the separator is a comma, the encoding is UTF-8. An empty cell is a missing sample, and so
is a word for one (`repairs.py`). A last line without its end is skipped.
Library: numpy; pyarrow 17 or later for large files, if installed. Limits: a line up to 4 MiB, 10,000 lines of metadata,
2**29 numbers. A file is read in blocks of complete lines, and one block is in memory at a time.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from typing import BinaryIO

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.access import library_errors, replaced_file
from piezod.recording.formats.csv_cells import arrow_parser, parse
from piezod.recording.formats.repairs import CUT_LINE, ZEROS, Repairs
from piezod.recording.formats.stream import MOST_VALUES, RecordingStream, Table, chunk_ranges, increasing, read_all
from piezod.recording.names import TIME, channel_name, name_columns
from piezod.recording.quantities import is_unit
from piezod.recording.recording import Recording

BLOCK = 2**22
"""Bytes that are parsed together: the numbers fit into the processor's cache, and calls cost little."""

LARGE = 2**24
"""File size above which parsing by pyarrow saves more time than its import costs [bytes]."""

MOST_HEAD_LINES = 10_000
"""Lines within which the header row must come."""

WRITTEN_ROWS = 2**14
"""Rows that are formatted together."""


def read_csv(path: Path) -> Recording:
    """Read a CSV recording with any suffix.

    Raises
    ------
    RecordingError
        The file cannot be read; the message names file, line, column and the wrong value.
    """
    with library_errors(path, "read"), open_csv(path) as stream:
        return read_all(stream)


@contextmanager
def open_csv(path: Path) -> Iterator[RecordingStream]:
    """Open a CSV file: metadata and header are read at once, rows with the chunks.

    Raises
    ------
    RecordingError
        The file has no valid header row.
    """
    with path.open("rb") as file:
        metadata, names = _read_head(file, path)
        arrow = arrow_parser(len(names)) if path.stat().st_size > LARGE else None

        def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
            columns = [names.index(name) for name in wanted]
            values = 0
            repairs = Repairs(metadata)
            for position, block in _blocks(file, path, repairs):
                table = parse(block, path, names, position, arrow, repairs)
                values += table.size
                if values > MOST_VALUES:
                    raise RecordingError(f"{path}: has more than {MOST_VALUES:.3g} numbers; split it")
                if table.size:
                    yield {name: np.ascontiguousarray(table[:, k]) for name, k in zip(wanted, columns, strict=True)}

        yield RecordingStream(path, names, lambda *request: increasing(chunks(*request), metadata), None, metadata)


def is_own_csv(path: Path) -> bool:
    """Whether a text file is a recording as `write_csv` writes it: its header begins with `time_s` and a comma."""
    with path.open("rb") as file:
        for _ in range(MOST_HEAD_LINES):
            line = file.readline(BLOCK)
            if not line or (line.strip() and not line.lstrip(b"\xef\xbb\xbf").startswith(b"#")):
                following = file.readline(BLOCK).decode("latin-1")
                if '"' in following or all(is_unit(cell) for cell in following.split(",")):
                    return False
                cells = line.removeprefix(b"\xef\xbb\xbf").decode("latin-1").split(",")
                return len(cells) > 1 and cells[0].strip() == TIME and all(cell.strip() for cell in cells)
    return False


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording: time to 1 ns, values to nine significant digits, missing samples as `nan`.

    An error leaves an existing file unchanged.

    Raises
    ------
    RecordingError
        The file cannot be written, a name would break the header row, or two samples are closer than 1 ns.
    """
    names = (TIME, *recording.channels)
    bad = [name for name in names if not name.strip() or name != name.strip() or set(name) & set(",#\r\n")]
    if bad:
        raise RecordingError(f"{path}: cannot be written: {bad[0]!r} is no column name of CSV, rename the channel")
    if (np.diff(np.round(recording.time_s, 9)) <= 0).any():
        raise RecordingError(f"{path}: cannot be written: samples are closer than 1 ns, the resolution of time in CSV")
    row = ",".join(["%.9f", *["%.9g"] * len(recording.channels)]) + "\n"
    table = [recording.time_s, *recording.channels.values()]
    with replaced_file(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        for key, value in recording.metadata.items():
            file.write(f"# {' '.join(key.split())}: {' '.join(value.split())}\n")
        file.write(",".join(names) + "\n")
        for start, stop in chunk_ranges(recording.time_s.size, WRITTEN_ROWS):
            block = np.column_stack([column[start:stop] for column in table])
            file.write("".join(repeat(row, len(block))) % tuple(block.ravel().tolist()))


def _read_head(file: BinaryIO, path: Path) -> tuple[dict[str, str], tuple[str, ...]]:
    """Metadata and column names; the file's position is then the first row."""
    metadata: dict[str, str] = {}
    for number in range(1, MOST_HEAD_LINES):
        raw = file.readline(BLOCK)
        if not raw or len(raw) == BLOCK:
            break
        try:
            line = raw.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            raise RecordingError(f"{path}: cannot be read: line {number} is not UTF-8 text: {error}") from error
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


def _blocks(file: BinaryIO, path: Path, repairs: Repairs) -> Iterator[tuple[int, bytes]]:
    """(position in the file [bytes], complete lines) of block after block; a last line without its end is skipped."""
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
    if rest.strip():
        repairs.skipped(CUT_LINE if rest.strip(b"\0") else ZEROS, rest[:BLOCK].decode("utf-8", "replace"))
