"""Recordings as MAT, one vector a channel: version 5, and to read also 7.3, which is HDF5 inside.

Only vectors of real numbers are loaded. Cells, structs, objects and function handles are left out unread.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.hdf5 import columns_of, numbers
from piezod.recording.formats.hdf5_heap import check_heaps
from piezod.recording.formats.mat5 import NUMBERS, numbers_of, text_of, variables
from piezod.recording.formats.stream import Source, Table, check_claim, one_length, replacing, require, skipped
from piezod.recording.names import TIME, name_columns
from piezod.recording.recording import Recording

VERSION_7_3 = b"MATLAB 7.3"
METADATA = "metadata"
"""The character variable that holds the metadata, a `key: value` a line."""

MOST_TEXT = 10**6
"""Characters that metadata may have."""

LONGEST_NAME = 31
"""Characters of a variable's name in version 5."""


def open_mat(path: Path) -> AbstractContextManager[Source]:
    """Open a MAT file of version 5 (read whole) or 7.3 (read as asked for).

    Raises
    ------
    RecordingError
        h5py is missing, or the variables are no recording.
    """
    with path.open("rb") as file:
        hdf5 = file.read(len(VERSION_7_3)) == VERSION_7_3
    return _open_7_3(path) if hdf5 else _open_5(path)


def write_mat(recording: Recording, path: Path) -> None:
    """Write a recording as version 5, whole or not at all; exact.

    Raises
    ------
    RecordingError
        A channel's name is no MATLAB name, or the file cannot be written.
    """
    scipy_io = require("scipy.io", "scipy", path)
    columns = {TIME: recording.time_s, **recording.channels}
    for name in columns:
        if not (name.isascii() and name.isidentifier() and len(name) <= LONGEST_NAME) or name in {"_", METADATA}:
            raise RecordingError(f"{path}: {name} must be a MATLAB name of at most {LONGEST_NAME} characters")
        if name.startswith("_"):
            raise RecordingError(f"{path}: {name} begins with an underscore, a MATLAB name begins with a letter")
    said = "\n".join(f"{key}: {' '.join(value.split())}" for key, value in recording.metadata.items())
    variables = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
    with replacing(path) as temporary, temporary.open("wb") as file:
        scipy_io.savemat(file, variables | ({METADATA: said} if said else {}), oned_as="column")


@contextmanager
def _open_5(path: Path) -> Iterator[Source]:
    with path.open("rb") as file:
        every = list(variables(file))
        vectors = [variable for variable in every if variable.is_vector]
        names = name_columns(path, [(vector.name, "") for vector in vectors])
        samples = one_length(path, dict(zip(names, (vector.numbers for vector in vectors), strict=True)))
        check_claim(path, samples * len(names))
        left_out = [f"{v.kind} {v.name}" for v in every if not v.is_vector and v.name != METADATA]
        said = [text_of(file, v) for v in every if v.name == METADATA and v.kind == "char" and v.numbers < MOST_TEXT]
        stored = dict(zip(names, vectors, strict=True))

        def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
            if samples:
                yield {name: numbers_of(file, stored[name]) for name in wanted}

        yield Source(path, names, chunks, samples, _metadata("".join(said)) | skipped(left_out))


@contextmanager
def _open_7_3(path: Path) -> Iterator[Source]:
    h5py = require("h5py", "hdf5", path)
    check_heaps(path)
    with h5py.File(path, "r") as file:
        datasets, left_out = numbers(h5py, file)
        kinds = {name: _kind(dataset) for name, dataset in datasets.items()}
        vectors = {name: dataset for name, dataset in datasets.items() if kinds[name] in {*NUMBERS, "logical", ""}}
        left_out += [f"{kinds[name]} {name}" for name in datasets if name not in vectors and name != METADATA]
        text = kinds.get(METADATA) == "char" and datasets[METADATA].size < MOST_TEXT
        metadata = _metadata("".join(map(chr, datasets[METADATA][()].ravel()))) if text else {}
        yield columns_of(path, vectors, metadata | skipped(left_out))


def _kind(dataset: Any) -> str:  # noqa: ANN401  h5py has no types
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _metadata(text: str) -> dict[str, str]:
    pairs = (line.partition(": ") for line in text.split("\n") if line.strip())
    return {key: value for key, _, value in pairs}
