"""Which file holds which format: reading, writing, streaming and converting by suffix."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.csv import open_csv, write_csv
from piezod.recording.formats.hdf5 import open_hdf5, write_hdf5
from piezod.recording.formats.mat import open_mat, write_mat
from piezod.recording.formats.mdf4 import open_mdf4, write_mdf4
from piezod.recording.formats.parquet import open_parquet, write_parquet
from piezod.recording.formats.sqlite import open_sqlite, write_sqlite
from piezod.recording.formats.stream import Source, foreign, require, whole
from piezod.recording.formats.tdms import open_tdms, write_tdms
from piezod.recording.names import TIME
from piezod.recording.recording import Recording, check_time


@dataclass(frozen=True)
class Format:
    """One file format: how files of it begin, what opens and writes them, and the (module, extra) it needs."""

    name: str
    magic: tuple[bytes, ...]
    open: Callable[[Path], AbstractContextManager[Source]]
    write: Callable[[Recording, Path], None]
    needs: tuple[str, str] | tuple[()] = ()


_HDF5 = Format("HDF5", (b"\x89HDF\r\n\x1a\n",), open_hdf5, write_hdf5, ("h5py", "hdf5"))

FORMATS = {
    ".csv": Format("CSV", (), open_csv, write_csv),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mat": Format("MAT", (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"), open_mat, write_mat),
    ".tdms": Format("TDMS", (b"TDSm",), open_tdms, write_tdms, ("nptdms", "tdms")),
    ".parquet": Format("Parquet", (b"PAR1",), open_parquet, write_parquet, ("pyarrow.parquet", "parquet")),
    ".mf4": Format("MDF4", (b"MDF     4.", b"UnFinMF "), open_mdf4, write_mdf4, ("asammdf", "mdf")),
    ".sqlite": Format("SQLite", (b"SQLite format 3\0",), open_sqlite, write_sqlite),
}


def read_recording(path: Path) -> Recording:
    """Read a recording of any format, whole.

    Parameters
    ----------
    path
        `.csv .h5 .hdf5 .mat .tdms .parquet .mf4 .sqlite`. Units that the format keeps apart are joined to the names;
        parts that hold no numbers are left out, `metadata["skipped"]` names them. Nothing in a file is ever executed.

    Raises
    ------
    RecordingError
        One line: the file, what is wrong with it, and where.
    """
    with _opened(path) as source:
        return whole(source)


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording in the format of the file's suffix, whole or not at all.

    Raises
    ------
    RecordingError
        The suffix is unknown, the format cannot hold it, its extra is missing, or the file cannot be written.
    """
    kind = _format(path)
    with foreign(path, "written"):
        kind.write(recording, path)


def convert(source: Path, target: Path) -> None:
    """Rewrite a recording in the format of another suffix.

    Raises
    ------
    RecordingError
        As `read_recording` and `write_recording`.
    """
    _format(target)
    write_recording(read_recording(source), target)


def open_stream(path: Path, columns: Sequence[str] | None = None, chunk: int = 65536) -> Iterator[Recording]:
    """Read a recording piece by piece; a file larger than memory will do (not `.mat` v5 and `.mf4`).

    Parameters
    ----------
    path
        As for `read_recording`.
    columns
        Channels wanted, None for all.
    chunk
        Most samples in a piece.

    Yields
    ------
    Recording
        The next samples; times go on from piece to piece.

    Raises
    ------
    RecordingError
        As `read_recording`, at the piece where the fault is met.
    """
    if chunk < 1:
        raise RecordingError(f"{path}: chunk is {chunk} samples, must be at least 1")
    with _opened(path) as source:
        names = _wanted(source, columns)
        done, end_s = 0, -np.inf
        for table in source.chunks(names, chunk):
            for start in range(0, table[TIME].size, chunk):
                piece = {name: table[name][start : start + chunk] for name in names}
                check_time(str(path), piece[TIME], done, end_s)
                done, end_s = done + piece[TIME].size, float(piece[TIME][-1])
                yield Recording(piece.pop(TIME), piece, source.metadata, str(path))


def column_names(path: Path) -> tuple[str, ...]:
    """Names of a file's columns, `time_s` among them; of its numbers none is read.

    Raises
    ------
    RecordingError
        As `read_recording`.
    """
    with _opened(path) as source:
        return source.names


def check_target(path: Path) -> None:
    """Refuse a file that could not be written, before the work whose result it is to hold.

    Raises
    ------
    RecordingError
        The suffix is unknown, its extra is missing, or the folder is not there or not to be written.
    """
    kind = _format(path)
    if kind.needs:
        require(*kind.needs, path)
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise RecordingError(f"{path}: cannot be written: {path.parent} must be a folder that may be written to")


def _wanted(source: Source, columns: Sequence[str] | None) -> tuple[str, ...]:
    wanted = source.names if columns is None else tuple(dict.fromkeys((TIME, *columns)))
    for name in wanted:
        if name not in source.names:
            raise RecordingError(f"{source.path}: has no column {name}, has {', '.join(source.names)[:200]}")
    return wanted


@contextmanager
def _opened(path: Path) -> Iterator[Source]:
    kind = _format(path)
    with foreign(path, "read"):
        _check_beginning(path, kind)
        with kind.open(path) as source:
            yield source


def _format(path: Path) -> Format:
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(f"{path}: suffix is {path.suffix!r}, must be one of {' '.join(FORMATS)}")
    return FORMATS[path.suffix.lower()]


def _check_beginning(path: Path, kind: Format) -> None:
    """Refuse a file whose first bytes are those of another format."""
    with path.open("rb") as file:
        head = file.read(32)
    if kind.magic and head.startswith(kind.magic):
        return
    others = [other.name for other in FORMATS.values() if other.magic and head.startswith(other.magic)]
    if others:
        raise RecordingError(f"{path}: holds {others[0]}, its suffix says {kind.name}; rename it")
    if kind.magic:
        raise RecordingError(f"{path}: is no {kind.name} file, begins with {head[:16]!r}")
