"""Recordings as MAT: one vector per channel, metadata in the character variable `metadata`.

Versions: 5 is read and written, 7.3 (an HDF5 file) is read. Libraries: scipy writes version 5, `mat5` reads it, and
h5py 3.11 or later reads 7.3. Limits: vectors of real numbers; 31 characters for a name; 10**6 for the metadata;
2**29 numbers.
Cells, structs, objects and function handles are skipped and never interpreted.
"""

import importlib
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.hdf5 import numeric_datasets, stream_of
from piezod.recording.formats.hdf5_heap import check_heaps
from piezod.recording.formats.mat5 import NUMBERS, read_numbers, read_text, read_variables
from piezod.recording.formats.stream import RecordingStream, Table, check_claimed_size, common_length, skipped_parts
from piezod.recording.names import TIME, name_columns
from piezod.recording.recording import Recording

VERSION_7_3 = b"MATLAB 7.3"
METADATA = "metadata"
"""Name of the character variable that holds the metadata, one line `key: value` per entry."""

MOST_TEXT = 10**6
"""Characters that the metadata may have."""

LONGEST_NAME = 31
"""Characters that the name of a variable may have in version 5."""


def open_mat(path: Path) -> AbstractContextManager[RecordingStream]:
    """Open a MAT file. A file of version 5 is one chunk, a file of 7.3 is read in chunks.

    Parameters
    ----------
    path
        MAT file of version 5 or 7.3.

    Raises
    ------
    RecordingError
        h5py is not installed, the vectors differ in length, or none is `time_s`.
    """
    with path.open("rb") as file:
        hdf5 = file.read(len(VERSION_7_3)) == VERSION_7_3
    return _open_7_3(path) if hdf5 else _open_5(path)


def write_mat(recording: Recording, path: Path) -> None:
    """Write a recording as version 5 without loss; an error leaves an existing file unchanged.

    Raises
    ------
    RecordingError
        A channel's name is no MATLAB name, or the file cannot be written.
    """
    scipy_io = importlib.import_module("scipy.io")  # late: the daemon reads recordings and never loads scipy
    columns = {TIME: recording.time_s, **recording.channels}
    for name in columns:
        if not (name.isascii() and name.isidentifier() and len(name) <= LONGEST_NAME) or name in {"_", METADATA}:
            raise RecordingError(f"{path}: {name} must be a MATLAB name of at most {LONGEST_NAME} characters")
        if name.startswith("_"):
            raise RecordingError(f"{path}: {name} begins with an underscore, a MATLAB name must begin with a letter")
    text = "\n".join(f"{key}: {' '.join(value.split())}" for key, value in recording.metadata.items())
    variables = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
    with replaced_file(path) as temporary, temporary.open("wb") as file:
        scipy_io.savemat(file, variables | ({METADATA: text} if text else {}), oned_as="column")


@contextmanager
def _open_5(path: Path) -> Iterator[RecordingStream]:
    with path.open("rb") as file:
        every = list(read_variables(file))
        vectors = [variable for variable in every if variable.is_vector]
        names = name_columns(path, [(vector.name, "") for vector in vectors])
        samples = common_length(path, dict(zip(names, (vector.count for vector in vectors), strict=True)))
        check_claimed_size(path, samples * len(names))
        skipped = [f"{v.kind} {v.name}" for v in every if not v.is_vector and v.name != METADATA]
        texts = [read_text(file, v) for v in every if v.name == METADATA and v.kind == "char" and v.count < MOST_TEXT]
        stored = dict(zip(names, vectors, strict=True))

        def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
            if samples:
                yield {name: read_numbers(file, stored[name]) for name in wanted}

        yield RecordingStream(path, names, chunks, samples, _metadata("".join(texts)) | skipped_parts(skipped))


@contextmanager
def _open_7_3(path: Path) -> Iterator[RecordingStream]:
    h5py = import_library("h5py", "hdf5", path)
    check_heaps(path)
    with h5py.File(path, "r") as file:
        datasets, skipped = numeric_datasets(h5py, file)
        kinds = {name: _kind(dataset) for name, dataset in datasets.items()}
        vectors = {name: dataset for name, dataset in datasets.items() if kinds[name] in {*NUMBERS, "logical", ""}}
        skipped += [f"{kinds[name]} {name}" for name in datasets if name not in vectors and name != METADATA]
        text = kinds.get(METADATA) == "char" and datasets[METADATA].size < MOST_TEXT
        metadata = _metadata("".join(map(chr, datasets[METADATA][()].ravel()))) if text else {}
        yield stream_of(path, vectors, metadata | skipped_parts(skipped))


def _kind(dataset: Any) -> str:  # noqa: ANN401  h5py has no types
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _metadata(text: str) -> dict[str, str]:
    pairs = (line.partition(": ") for line in text.split("\n") if line.strip())
    return {key: value for key, _, value in pairs}
