"""`RecordingStream`: an open recording file of any format as named columns in chunks; and limits on its size."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording.names import TIME
from piezod.recording.recording import Recording
from piezod.recording.time_stamps import TimeStamps

Table = dict[str, Array]  # column name to values; all values of a table have equal lengths
MOST_VALUES = 2**29  # numbers that a recording may hold: 4.3 GB as float64
UNCHECKED_VALUES = 1_000_000  # numbers that a file of any size may claim to hold
VALUES_PER_BYTE = 1000  # further numbers that a file may claim per byte of its size; the deflate algorithm reaches 129
READ_CHUNK = 2**20  # samples per chunk when a file is read completely
GROWTH = 1.1  # factor by which a full buffer grows
MOST_SKIPPED_TEXT = 500  # characters of the list of skipped parts


@dataclass(frozen=True)
class RecordingStream:
    """An open recording file.

    Parameters
    ----------
    names
        Column names, `time_s` among them.
    chunks
        Function of (column names, number of samples). It yields tables of these columns in the order of time, each of
        about this number of samples; a format with chunks of its own may ignore the number.
    samples
        Length of the columns as the file's header states it; None for a format whose header does not state it.
    metadata
        Keys and values of the file's own description.

    Raises
    ------
    RecordingError
        A file of this size cannot hold the stated number of samples.
    """

    path: Path
    names: tuple[str, ...]
    chunks: Callable[[Sequence[str], int], Iterator[Table]]
    samples: int | None = None
    metadata: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the stated length before anything is allocated."""
        if self.samples is not None:
            check_claimed_size(self.path, self.samples * len(self.names))


def read_all(stream: RecordingStream) -> Recording:
    """Recording of everything that a file holds.

    Parameters
    ----------
    stream
        Open recording file; it is read to its end.

    Raises
    ------
    RecordingError
        The file holds no samples, or its time does not strictly increase.
    """
    columns = {name: GrowingColumn() for name in stream.names}
    for part in stream.chunks(stream.names, READ_CHUNK):
        for name, column in columns.items():
            column.add(part[name])
    if not columns[TIME].size:
        more = f"; {stream.metadata['left_out']}" if "left_out" in stream.metadata else ""
        raise RecordingError(f"{stream.path}: has a header but no samples{more}")
    values = {name: column.values() for name, column in columns.items()}
    return Recording(values.pop(TIME), values, stream.metadata, str(stream.path))


class GrowingColumn:
    """Buffer for samples that arrive in pieces; joining the pieces at the end would need twice the memory."""

    def __init__(self) -> None:
        self._values = np.empty(0)
        self.size = 0

    def add(self, piece: Array) -> None:
        """Append a piece."""
        size = self.size + piece.size
        if size > self._values.size:
            self._values.resize(int(GROWTH * size) if self.size else size, refcheck=False)  # the system moves pages
        self._values[self.size : size] = piece
        self.size = size

    def values(self) -> Array:
        """All samples, shape (size,)."""
        self._values.resize(self.size, refcheck=False)
        return self._values


def increasing(tables: Iterator[Table], metadata: dict[str, str]) -> Iterator[Table]:
    """The tables of a text without repeated times; `metadata["time"]` describes the changes.

    Parameters
    ----------
    tables
        Blocks of the file, with the time among the columns. They must not depend on the number of samples in a
        chunk: the meaning of a repeated stamp is decided block by block.
    metadata
        Metadata of the file; `time` is set.
    """
    stamps = TimeStamps()
    for table in stamps.cleaned(tables, TIME):
        if stamps.notes:
            metadata["time"] = "; ".join(stamps.notes)
        yield table


def check_claimed_size(path: Path, values: int) -> None:
    """Refuse a file that claims to hold more numbers than its size or `MOST_VALUES` allows.

    Parameters
    ----------
    path
        The file; its size sets the limit.
    values
        Numbers that the file claims to hold.

    Raises
    ------
    RecordingError
        The number is too large; the message states it and the limit.
    """
    limit = min(MOST_VALUES, UNCHECKED_VALUES + VALUES_PER_BYTE * path.stat().st_size)
    if not 0 <= values <= limit:
        raise RecordingError(f"{path}: claims {values:.3g} numbers, a file of its size may hold {limit:.3g}")


def common_length(path: Path, lengths: dict[str, int]) -> int:
    """Length of all columns; 0 for no columns.

    Parameters
    ----------
    lengths
        Length by column name [samples].

    Raises
    ------
    RecordingError
        Two columns differ in length; the message names both.
    """
    first = next(iter(lengths), "")
    for name, length in lengths.items():
        if length != lengths[first]:
            raise RecordingError(f"{path}: {name} has {length} samples, {first} has {lengths[first]}; must be the same")
    return lengths.get(first, 0)


def chunk_ranges(samples: int, chunk: int) -> Iterator[tuple[int, int]]:
    """(start, stop) of each chunk; the last one may be shorter.

    Parameters
    ----------
    samples
        Length of the columns, at least 0.
    chunk
        Samples per chunk, at least 1.
    """
    for start in range(0, samples, chunk):
        yield start, min(start + chunk, samples)


def skipped_parts(parts: Sequence[str]) -> dict[str, str]:
    """Metadata entry `skipped` with the names of the parts of a file that hold no numbers; empty without such parts."""
    return {"skipped": ", ".join(parts)[:MOST_SKIPPED_TEXT]} if parts else {}
