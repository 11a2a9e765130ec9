"""Reading, writing and conversion of recording files; the suffix of a file determines its format."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from piezod.errors import ConfigurationError, RecordingError, UsageError
from piezod.recording.formats.access import import_library, library_errors, open_file
from piezod.recording.formats.csv import write_csv
from piezod.recording.formats.hdf5 import open_hdf5, write_hdf5
from piezod.recording.formats.mat import open_mat, write_mat
from piezod.recording.formats.mdf4 import open_mdf4, write_mdf4
from piezod.recording.formats.parquet import open_parquet, write_parquet
from piezod.recording.formats.scale import scaled
from piezod.recording.formats.spreadsheet import open_spreadsheet, write_spreadsheet
from piezod.recording.formats.sqlite import open_sqlite, write_sqlite
from piezod.recording.formats.stream import RecordingStream, chunk_ranges, read_all
from piezod.recording.formats.tdms import open_tdms, write_tdms
from piezod.recording.formats.text import open_text
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME
from piezod.recording.recording import Recording, check_time


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    magic
        First bytes of a file of this format, one of several; empty: a file may begin with any bytes.
    open, write
        Functions that open and write a file.
    needs
        (module, extra) of the optional library; empty: none.
    """

    name: str
    magic: tuple[bytes, ...]
    open: Callable[[Path, TextOptions], AbstractContextManager[RecordingStream]]
    write: Callable[[Recording, Path], None]
    needs: tuple[str, str] | tuple[()] = ()


_HDF5 = Format("HDF5", (b"\x89HDF\r\n\x1a\n",), open_hdf5, write_hdf5, ("h5py", "hdf5"))

READ_ONLY = (".txt", ".tsv", ".dat", ".asc", ".lvm", ".nc")
"""Suffixes of text that other programs write, and of netCDF, which is HDF5."""

FOREIGN = {
    **dict.fromkeys((".dxd", ".d7d", ".dxz"), "DEWESoft"),
    **dict.fromkeys((".wfm", ".trc", ".isf", ".psdata"), "an oscilloscope"),
    **dict.fromkeys((".opj", ".opju"), "Origin"),
    **dict.fromkeys((".mdf", ".tdm", ".tdx"), "MDF 3 or DIAdem"),
    ".idf": "dSPACE ControlDesk",
    ".raw": "imc FAMOS",
    ".bin": "catman or another program",
}
COMPRESSED = (".gz", ".zip", ".bz2", ".xz", ".zst", ".7z")  # compressed files, which are unpacked first

"""Binary formats of other programs that are not read, by suffix."""

EXPORT = "export it there as text (.csv), .mat, .tdms or .mf4"

FOREIGN_MAGIC = {b"|CF,": "imc FAMOS", b"CDF\x01": "netCDF 3", b"CDF\x02": "netCDF 3"}

_SPREADSHEET = Format(
    "a workbook",
    (b"PK\x03\x04", b"\xd0\xcf\x11\xe0"),
    open_spreadsheet,
    write_spreadsheet,
    ("python_calamine", "xlsx"),
)

SPREADSHEETS = {".xlsx": _SPREADSHEET, ".xls": _SPREADSHEET, ".ods": _SPREADSHEET}  # workbooks, which are only read
FORMATS = {
    ".csv": Format("CSV", (), open_text, write_csv),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".mat": Format("MAT", (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"), open_mat, write_mat),
    ".tdms": Format("TDMS", (b"TDSm",), open_tdms, write_tdms, ("nptdms", "tdms")),
    ".parquet": Format("Parquet", (b"PAR1",), open_parquet, write_parquet, ("pyarrow.parquet", "parquet")),
    ".mf4": Format("MDF4", (b"MDF     4.", b"UnFinMF "), open_mdf4, write_mdf4, ("asammdf", "mdf")),
    ".sqlite": Format("SQLite", (b"SQLite format 3\0",), open_sqlite, write_sqlite),
}
"""The formats that are written too."""


def read_recording(path: Path, options: TextOptions | None = None) -> Recording:
    """Read a recording of any format completely.

    Parameters
    ----------
    path
        File with a suffix of `FORMATS`, `READ_ONLY` or `SPREADSHEETS`. A unit that the file stores separately from the
        name of a channel is appended to the name. Parts that hold no numbers are skipped, and `metadata["skipped"]`
        names them. Nothing in a file is ever executed.
    options
        Layout of a text file as the user states it; None: inferred from the file.

    Raises
    ------
    RecordingError
        The file cannot be read; the message names the file, the fault and its place.
    """
    with _open(path, options) as stream:
        return read_all(stream)


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording in the format of the file's suffix; an error leaves an existing file unchanged.

    Parameters
    ----------
    path
        Target file; its suffix selects the format.

    Raises
    ------
    RecordingError
        The suffix is unknown, the format cannot hold this recording, its library is not installed, or the file cannot
        be written.
    """
    file_format = _format_of(path)
    with library_errors(path, "written"):
        file_format.write(recording, path)


def convert(source: Path, target: Path, options: TextOptions | None = None) -> Recording:
    """Rewrite a recording in the format of another suffix, and return it.

    Parameters
    ----------
    source
        Recording file to read; it is not changed.
    target
        File to write; another file than `source`.
    options
        As for `read_recording`.

    Raises
    ------
    RecordingError, UsageError
        See `check_recording_target`, `read_recording` and `write_recording`.
    """
    check_recording_target(target, [source])
    recording = read_recording(source, options)
    write_recording(recording, target)
    return recording


def open_stream(
    path: Path, columns: Sequence[str] | None = None, chunk: int = 65536, options: TextOptions | None = None
) -> Iterator[Recording]:
    """Read a recording in chunks. The file may be larger than memory, except `.mat` of version 5 and `.mf4`.

    Parameters
    ----------
    path
        File, see `read_recording`.
    columns
        Names of the channels to read; None: all.
    chunk
        Largest number of samples in a chunk, at least 1.
    options
        As for `read_recording`.

    Yields
    ------
    Recording
        The next samples; time continues from chunk to chunk.

    Raises
    ------
    RecordingError
        See `read_recording`; raised when the chunk with the fault is read.
    """
    if chunk < 1:
        raise RecordingError(f"{path}: chunk is {chunk} samples, must be at least 1")
    with _open(path, options) as stream:
        names = _wanted(stream, columns)
        done, end_s = 0, -np.inf
        for table in stream.chunks(names, chunk):
            for start, stop in chunk_ranges(table[TIME].size, chunk):
                piece = {name: table[name][start:stop] for name in names}
                check_time(str(path), piece[TIME], done, end_s)
                done, end_s = done + piece[TIME].size, float(piece[TIME][-1])
                yield Recording(piece.pop(TIME), piece, stream.metadata, str(path))


def column_names(path: Path, options: TextOptions | None = None) -> tuple[str, ...]:
    """Names of a file's columns, `time_s` among them; the numbers are not read.

    Parameters
    ----------
    options
        As for `read_recording`.

    Raises
    ------
    RecordingError
        See `read_recording`.
    """
    with _open(path, options) as stream:
        return stream.names


def check_output_path(target: Path, recordings: Sequence[Path] = ()) -> None:
    """Check, before the work begins, that a result of any kind may be written to a file.

    Parameters
    ----------
    recordings
        Files that are read for it and must not be overwritten.

    Raises
    ------
    UsageError
        The file is one of the recordings.
    ConfigurationError
        Its folder does not exist.
    """
    _check_not_read(target, recordings)
    if not target.parent.is_dir():
        raise ConfigurationError(f"{target}: cannot be written: {target.parent} is no folder, make it first")


def check_recording_target(target: Path, recordings: Sequence[Path] = ()) -> None:
    """Check, before the work begins, that a recording can be written to a file.

    Parameters
    ----------
    recordings
        Files that the command reads and must not overwrite.

    Raises
    ------
    RecordingError
        The suffix is unknown, the library of the format is not installed, or the folder is missing or not writable.
    UsageError
        The file is one of the recordings.
    """
    file_format = _format_of(target)
    if file_format.needs:
        import_library(*file_format.needs, target)
    if not target.parent.is_dir() or not os.access(target.parent, os.W_OK):
        raise RecordingError(f"{target}: cannot be written: {target.parent} must be a folder that may be written to")
    _check_not_read(target, recordings)


def _check_not_read(target: Path, recordings: Sequence[Path]) -> None:
    if any(target.exists() and path.exists() and target.samefile(path) for path in recordings):
        raise UsageError(f"-o is {target}, which is a recording that is read, must be another file")


def _wanted(stream: RecordingStream, columns: Sequence[str] | None) -> tuple[str, ...]:
    wanted = stream.names if columns is None else tuple(dict.fromkeys((TIME, *columns)))
    for name in wanted:
        if name not in stream.names:
            raise RecordingError(f"{stream.path}: has no column {name}, has {', '.join(stream.names)[:200]}")
    return wanted


@contextmanager
def _open(path: Path, options: TextOptions | None = None) -> Iterator[RecordingStream]:
    file_format = _format_of(path, to_read=True)
    options = options or TextOptions()
    if file_format.name == "SQLite" and options.is_stated:
        raise UsageError(f"{path}: --columns, --rate-Hz and --decimal are for text files, this is {file_format.name}")
    if options.decimal and file_format.name not in ("CSV", _SPREADSHEET.name):
        raise UsageError(f"{path}: --decimal is for text files, this is {file_format.name}")
    with library_errors(path, "read"):
        _check_magic(path, file_format)
        with file_format.open(path, replace(options, scale=())) as stream:
            yield scaled(stream, options.scale) if options.scale else stream


def _format_of(path: Path, *, to_read: bool = False) -> Format:
    suffix = path.suffix.lower()
    if to_read and path.is_dir():
        raise RecordingError(f"{path}: is a folder, must be a recording")
    if to_read and suffix in READ_ONLY:
        return _HDF5 if suffix == ".nc" else FORMATS[".csv"]
    if to_read and suffix in FOREIGN:
        raise RecordingError(f"{path}: is a file of {FOREIGN[suffix]}, which is not read; {EXPORT}")
    if to_read and suffix in COMPRESSED:
        raise RecordingError(f"{path}: is compressed; unpack it first")
    if suffix in SPREADSHEETS:
        return SPREADSHEETS[suffix]
    if suffix not in FORMATS:
        known = (*FORMATS, *READ_ONLY, *SPREADSHEETS) if to_read else FORMATS
        raise RecordingError(f"{path}: suffix is {path.suffix!r}, must be one of {' '.join(known)}")
    return FORMATS[suffix]


def _check_magic(path: Path, file_format: Format) -> None:
    """Refuse a file whose first bytes belong to another format."""
    with open_file(path) as file:
        head = file.read(32)
    if file_format.magic and head.startswith(file_format.magic):
        return
    for magic, program in FOREIGN_MAGIC.items():
        if head.startswith(magic):
            raise RecordingError(f"{path}: is a file of {program}, which is not read; {EXPORT}")
    others = [other.name for other in (*FORMATS.values(), _SPREADSHEET) if other.magic and head.startswith(other.magic)]
    if others:
        raise RecordingError(f"{path}: holds {others[0]}, its suffix says {file_format.name}; rename it")
    if file_format.magic:
        kind = "workbook" if file_format is _SPREADSHEET else f"{file_format.name} file"
        raise RecordingError(f"{path}: is no {kind}, begins with {head[:16]!r}")
