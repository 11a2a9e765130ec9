"""Recordings as CSV as piezod writes them: lines of metadata that begin with `#`, one header row, one row per sample.

The first column is `time_s`, the separator is a comma, the encoding is UTF-8. `text.py` reads the rows. Library: numpy;
pyarrow 17 or later for large files, if installed. Limits: a line up to 4 MiB, 10,000 lines of metadata, 2**29 numbers.
"""

import re
from collections.abc import Sequence
from itertools import repeat
from pathlib import Path
from typing import BinaryIO

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.access import replaced_file
from piezod.recording.formats.stream import chunk_ranges
from piezod.recording.formats.text_layout import SAMPLE, Layout
from piezod.recording.formats.text_rows import text_cells
from piezod.recording.names import TIME, channel_name, name_columns
from piezod.recording.quantities import Column, is_unit
from piezod.recording.recording import Recording

LONGEST_LINE = 2**22  # length of a line [bytes]
MOST_HEAD_LINES = 10_000  # lines within which the header row must come
_OWN_LETTERS = re.compile("[^0-9eEnaif+., \\t\\r\\n-]")  # a character that no number of `write_csv` has
WRITTEN_ROWS = 2**14  # rows that are formatted together


def own_layout(path: Path, *, required: bool = False) -> Layout | None:
    """Layout of a recording as `write_csv` writes it; None for another text.

    Parameters
    ----------
    required
        Whether any other text is refused.

    Raises
    ------
    RecordingError
        The file is empty, or its header row has a name twice.
    """
    with path.open("rb") as file:
        metadata, line, number = _read_head(file, path, required=required)
        lines = file.read(SAMPLE).decode("latin-1").split("\n")
    cells = line.split(",")
    if required and channel_name(cells[0]) != TIME:
        raise RecordingError(f"{path}: first column is {cells[0].strip()[:40]!r}, must be {TIME}")
    if not required and not _is_own(cells, [line.strip("\r") for line in lines]):
        return None
    names = name_columns(path, [(cell, "") for cell in cells])
    columns = tuple(Column(name, "time" if name == TIME else "", "s" if name == TIME else "") for name in names)
    return Layout(
        *("utf-8-sig", ",", ".", False, number, columns, tuple(range(len(names))), len(names)),
        time=names.index(TIME),
        metadata=metadata,
        own=True,
        header=frozenset([line.strip()]),
    )


def _is_own(cells: Sequence[str], following: Sequence[str]) -> bool:
    """Whether a header begins with `time_s`, without quotes, and no column below it holds units or words."""
    if len(cells) < 2 or cells[0].strip() != TIME or not all(cell.strip() and '"' not in cell for cell in cells):
        return False
    if '"' in following[0] or all(is_unit(cell) for cell in following[0].split(",")):
        return False
    if len(following) > 1 and not _OWN_LETTERS.search("\n".join(following[:-1])):  # the last line is perhaps cut
        return True
    return not text_cells(following[: -1 if len(following) > 1 else None], ",", ".", len(cells))


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


def _read_head(file: BinaryIO, path: Path, *, required: bool) -> tuple[dict[str, str], str, int]:
    """Metadata, header row, and number of lines up to it; the file's position is then the first row."""
    metadata: dict[str, str] = {}
    for number in range(1, MOST_HEAD_LINES):
        raw = file.readline(LONGEST_LINE)
        if not raw or len(raw) == LONGEST_LINE:
            break
        try:
            line = raw.decode("utf-8-sig" if number == 1 else "utf-8")
        except UnicodeDecodeError as error:
            if not required:
                break
            raise RecordingError(f"{path}: cannot be read: line {number} is not UTF-8 text: {error}") from error
        if line.startswith("#"):
            key, _, value = line[1:].partition(":")
            metadata[key.strip()] = value.strip()
        elif line.strip():
            return metadata, line, number
    if required:
        raise RecordingError(f"{path}: is empty, must hold a header row and samples")
    return {}, "", 0
