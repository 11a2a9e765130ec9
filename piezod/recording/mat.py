"""Recordings as MAT: one vector a channel. Version 5 by scipy.io, version 7.3 (HDF5 inside) by h5py.

Only vectors of real numbers are loaded. Cells, structs, objects and function handles are left out unread.
"""

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.hdf5 import columns_of, numbers
from piezod.recording.names import TIME, name_columns
from piezod.recording.recording import Recording
from piezod.recording.source import Source, Table, check_claim, one_length, replacing, require, skipped, spans

VERSION_7_3 = b"MATLAB 7.3"
METADATA = "metadata"
"""The character variable that holds the metadata, a `key: value` a line."""

NUMBERS = {"double", "single", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "logical"}

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
    scipy_io = require("scipy.io", "scipy", path)
    with path.open("rb") as file:
        listed = scipy_io.whosmat(file)
        sizes = {name: _size(shape) for name, shape, kind in listed if kind in NUMBERS and _is_vector(shape)}
        left_out = [f"{kind} {name}" for name, _, kind in listed if name not in sizes and name != METADATA]
        check_claim(path, sum(sizes.values()))
        text = [name for name, shape, kind in listed if name == METADATA and kind == "char" and _size(shape) < 10**6]
        loaded = scipy_io.loadmat(file, variable_names=[*sizes, *text])
    found = {name: loaded[name] for name in sizes if not np.iscomplexobj(loaded[name])}
    names = name_columns(path, [(name, "") for name in found])
    vectors = dict(zip(names, found.values(), strict=True))
    samples = one_length(path, {name: vector.size for name, vector in vectors.items()})

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        for start, stop in spans(samples, chunk):
            yield {name: vectors[name].ravel()[start:stop].astype(np.float64) for name in wanted}

    metadata = _metadata(loaded[METADATA]) if text else {}
    yield Source(path, names, chunks, samples, metadata | skipped(left_out))


@contextmanager
def _open_7_3(path: Path) -> Iterator[Source]:
    h5py = require("h5py", "hdf5", path)
    with h5py.File(path, "r") as file:
        datasets, left_out = numbers(h5py, file)
        kinds = {name: _kind(dataset) for name, dataset in datasets.items()}
        vectors = {name: dataset for name, dataset in datasets.items() if kinds[name] in {*NUMBERS, ""}}
        left_out += [f"{kinds[name]} {name}" for name in datasets if name not in vectors and name != METADATA]
        text = kinds.get(METADATA) == "char" and datasets[METADATA].size < 10**6
        metadata = _metadata("".join(map(chr, datasets[METADATA][()].ravel()))) if text else {}
        yield columns_of(path, vectors, metadata | skipped(left_out))


def _kind(dataset: Any) -> str:  # noqa: ANN401  h5py has no types
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _metadata(text: Any) -> dict[str, str]:  # noqa: ANN401  a string, or an array of one
    lines = "".join(np.asarray(text).ravel().tolist()).split("\n")
    pairs = (line.partition(": ") for line in lines if line.strip())
    return {key: value for key, _, value in pairs}


def _is_vector(shape: Sequence[int]) -> bool:
    return len(shape) == 2 and 1 in shape


def _size(shape: Sequence[int]) -> int:
    size = 1
    for length in shape:
        size *= int(length)
    return size
