"""Recordings as MAT: one vector per channel, metadata in the character variable `metadata`.

Versions: 5 is read and written, 7.3 (an HDF5 file) is read. Libraries: scipy writes version 5, `mat5` reads it, and
h5py 3.11 or later reads 7.3. Limits: vectors of real numbers; 31 characters for a name; 10**6 for the metadata;
2**29 numbers.
Structs are searched where no vector beside them is a time. Cells, objects (`timetable`, `timeseries`) and function
handles are skipped and never interpreted.
"""

import importlib
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.hdf5 import stream_of, vectors_of
from piezod.recording.formats.hdf5_heap import check_heaps
from piezod.recording.formats.mat5 import NUMBERS, Variable, read_fields, read_numbers, read_text, read_variables
from piezod.recording.formats.named_columns import Raw, Stored, named_stream
from piezod.recording.formats.stream import RecordingStream, check_claimed_size, skipped_parts
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME
from piezod.recording.recording import Recording

VERSION_7_3 = b"MATLAB 7.3"
METADATA = "metadata"  # name of the character variable that holds the metadata, one line `key: value` per entry
MOST_TEXT = 10**6  # characters that the metadata may have
LABELS, VALUES = ("name", "label", "signalname"), ("values", "data", "value", "samples", "y")
"""Fields of a struct that name a vector, and that hold it."""

UNITS = ("unit", "units")  # fields of a struct that hold the unit of its vector
MOST_LABEL = 100  # characters of such a name
LONGEST_NAME = 31  # characters that the name of a variable may have in version 5


def open_mat(path: Path, options: TextOptions) -> AbstractContextManager[RecordingStream]:
    """Open a MAT file. A file of version 5 is one chunk, a file of 7.3 is read in chunks.

    Raises
    ------
    RecordingError
        h5py is not installed, the vectors differ in length, or as for `named_stream`.
    """
    with path.open("rb") as file:
        hdf5 = file.read(len(VERSION_7_3)) == VERSION_7_3
    return _open_7_3(path, options) if hdf5 else _open_5(path, options)


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
def _open_5(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
    with path.open("rb") as file:
        every = list(read_variables(file))
        texts = [read_text(file, v) for v in every if v.name == METADATA and v.kind == "char" and v.count < MOST_TEXT]
        flat = {v.name: v for v in every if v.is_vector}
        if options.columns or not any(stored.is_time for stored in _stored(flat)):
            flat, every = _with_fields(file, path, flat, every)
        check_claimed_size(path, sum(variable.count for variable in flat.values()))
        skipped = [f"{v.kind} {v.name}" for v in every if v.name not in flat and v.name != METADATA]

        def pieces(wanted: Sequence[str], _: int) -> Iterator[Raw]:
            yield {name: _vector(file, flat, name) for name in wanted}

        metadata = _metadata("".join(texts)) | skipped_parts(skipped)
        yield named_stream(path, _stored(flat), pieces, metadata, options)


def _with_fields(
    file: BinaryIO, path: Path, flat: dict[str, Variable], every: list[Variable]
) -> tuple[dict[str, Variable], list[Variable]]:
    """The vectors and matrices by their paths, those in structs too, and the other variables.

    A field that is called `name` or `label` names its vector: `signals(2)/values` is `signals(2)/force`.
    """
    structs = [variable for variable in every if variable.kind == "struct"]
    check_claimed_size(path, sum(variable.size for variable in structs) // 8)
    fields = {name: field for struct in structs for name, field in read_fields(file, struct)}
    texts = {name: field for name, field in fields.items() if field.kind == "char" and 0 < field.count < MOST_LABEL}
    labels = {_above(name): read_text(file, f).strip() for name, f in texts.items() if _own(name).lower() in LABELS}
    units = {_above(name): read_text(file, f).strip() for name, f in texts.items() if _own(name).lower() in UNITS}
    tables = dict(flat)
    for name, field in fields.items():
        above, is_labelled = _above(name), _above(name) in labels and _own(name).lower() in VALUES
        if field.is_vector or field.is_matrix:
            unit = units.get(above, "") if is_labelled else ""
            labelled = f"{above}/{labels[above]}" if is_labelled else name
            tables[name if labelled in tables else labelled] = replace(field, unit=unit)
    tables |= {variable.name: variable for variable in every if variable.is_matrix}
    if len(tables) < 2 and not flat and not any(variable.is_matrix for variable in every):
        return flat, every
    return tables, [variable for variable in every if variable not in structs and not variable.is_matrix]


def _above(name: str) -> str:
    return name.rpartition("/")[0]


def _own(name: str) -> str:
    return name.rpartition("/")[2]


def _stored(variables: dict[str, Variable]) -> list[Stored]:
    """The vectors, and the columns of the matrices."""
    stored = []
    for name, variable in variables.items():
        if variable.is_vector:
            stored.append(Stored(name, variable.count, variable.unit, _own(name)))
        else:
            rows, columns = max(variable.shape), range(1, min(variable.shape) + 1)
            stored += [Stored(f"{name}:{k}", rows, "", f"{_own(name)}_{k}", of_matrix=True) for k in columns]
    return stored


def _vector(file: BinaryIO, variables: dict[str, Variable], name: str) -> Array:
    if name in variables:
        return read_numbers(file, variables[name])
    base, _, place = name.rpartition(":")
    variable = variables[base]
    matrix = read_numbers(file, variable).reshape(variable.shape, order="F")
    column: Array = matrix[:, int(place) - 1] if variable.shape[0] >= variable.shape[1] else matrix[int(place) - 1]
    return column


@contextmanager
def _open_7_3(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
    h5py = import_library("h5py", "hdf5", path)
    check_heaps(path)
    with h5py.File(path, "r") as file:
        every, skipped = vectors_of(h5py, file)
        kinds = {name: _kind(vector.dataset) for name, vector in every.items()}
        vectors = {name: vector for name, vector in every.items() if kinds[name] in {*NUMBERS, "logical", ""}}
        skipped += [f"{kinds[name]} {name}" for name in every if name not in vectors and name != METADATA]
        text = kinds.get(METADATA) == "char" and every[METADATA].dataset.size < MOST_TEXT
        metadata = _metadata("".join(map(chr, every[METADATA].dataset[()].ravel()))) if text else {}
        yield stream_of(path, vectors, metadata | skipped_parts(skipped), options)


def _kind(dataset: Any) -> str:  # noqa: ANN401  h5py has no types
    kind = dataset.attrs.get("MATLAB_class", b"")
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _metadata(text: str) -> dict[str, str]:
    pairs = (line.partition(": ") for line in text.split("\n") if line.strip())
    return {key: value for key, _, value in pairs}
