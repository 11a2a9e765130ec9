"""Recordings as HDF5: one dataset per channel, its unit as an attribute, metadata as attributes of the root group.

Library: h5py 3.11 or later; reads every version of the file format that h5py reads, writes the format of HDF5 1.8.
Limits: vectors and matrices of one row or column, in the root group or a group directly below it; 2**29 numbers.
Skipped are external links, external storage and virtual datasets, because they lead to other files. References, text
and tables are skipped, because they hold no numbers.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.hdf5_heap import check_heaps
from piezod.recording.formats.stream import RecordingStream, Table, chunk_ranges, common_length, skipped_parts
from piezod.recording.names import TIME, name_columns, unit_of
from piezod.recording.recording import Recording

UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")
"""Names of the attribute that holds a dataset's unit, in the order in which they are tried."""


@contextmanager
def open_hdf5(path: Path) -> Iterator[RecordingStream]:
    """Open an HDF5 file: its datasets are listed at once, numbers are read with the chunks.

    Parameters
    ----------
    path
        HDF5 file.

    Raises
    ------
    RecordingError
        h5py is not installed, the datasets differ in length, or none is `time_s`.
    """
    h5py = import_library("h5py", "hdf5", path)
    check_heaps(path)
    with h5py.File(path, "r") as file:
        datasets, skipped = numeric_datasets(h5py, file)
        metadata = {key: text for key in file.attrs if (text := attribute_text(file.attrs.get(key)))}
        yield stream_of(path, datasets, metadata | skipped_parts(skipped))


def stream_of(path: Path, datasets: dict[str, Any], metadata: dict[str, str]) -> RecordingStream:
    """Stream whose columns are these datasets, each a vector or a matrix of one row or column.

    Parameters
    ----------
    path
        File of the datasets, for messages.
    datasets
        Datasets of an open file, by name, each of N numbers.
    metadata
        Keys and values of the file's own description.

    Raises
    ------
    RecordingError
        The datasets differ in length, two have equal names, or none is `time_s`.
    """
    names = name_columns(path, [(name, _unit(dataset)) for name, dataset in datasets.items()])
    vectors = dict(zip(names, datasets.values(), strict=True))
    samples = common_length(path, {name: int(vector.size) for name, vector in vectors.items()})

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        for start, stop in chunk_ranges(samples, chunk):
            yield {name: _piece(vectors[name], start, stop) for name in wanted}

    return RecordingStream(path, names, chunks, samples, metadata)


def write_hdf5(recording: Recording, path: Path) -> None:
    """Write a recording without loss; an error leaves an existing file unchanged.

    Raises
    ------
    RecordingError
        h5py is not installed, or the file cannot be written.
    """
    h5py = import_library("h5py", "hdf5", path)
    with (
        replaced_file(path) as temporary,
        h5py.File(temporary, "w", libver=("v108", "latest"), track_order=True) as file,
    ):
        for key, value in recording.metadata.items():
            file.attrs[key] = value
        for name, values in {TIME: recording.time_s, **recording.channels}.items():
            dataset = file.create_dataset(name, data=np.asarray(values, dtype=np.float64))
            dataset.attrs["unit"] = unit_of(name)


def numeric_datasets(h5py: Any, file: Any) -> tuple[dict[str, Any], list[str]]:  # noqa: ANN401  h5py has no types
    """Datasets of numbers in the root group and one level below, and the paths of the skipped parts.

    The key is the dataset's name, or its path if another dataset has this name.

    Parameters
    ----------
    h5py
        The module h5py.
    file
        Open file of h5py.
    """
    datasets: dict[str, Any] = {}
    skipped: list[str] = []
    for path, item in _items(h5py, file, skipped):
        if isinstance(item, h5py.Group) and item != file["/"]:
            for below, dataset in _items(h5py, item, skipped):
                _add_dataset(h5py, f"{path}/{below}", dataset, datasets, skipped)
        else:
            _add_dataset(h5py, path, item, datasets, skipped)
    names = {path: path.rpartition("/")[2] for path in datasets}
    count = Counter(names.values())
    return {name if count[name] == 1 else path: datasets[path] for path, name in names.items()}, skipped


def attribute_text(value: Any) -> str:  # noqa: ANN401  an attribute is of any type
    """Attribute as text; empty for an attribute of another type.

    Parameters
    ----------
    value
        Value of an attribute of any type.
    """
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""


def _items(h5py: Any, group: Any, skipped: list[str]) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """(name, item) of each member of a group that is stored in this file; names of links are added to `skipped`."""
    for name in group:
        if name.startswith("#"):
            continue  # MATLAB stores its internal objects under such names
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]
        else:
            skipped.append(f"link {name}")


def _add_dataset(h5py: Any, path: str, item: Any, datasets: dict[str, Any], skipped: list[str]) -> None:  # noqa: ANN401
    vector = isinstance(item, h5py.Dataset) and item.ndim in {1, 2} and item.size in item.shape
    if vector and item.dtype.kind in "fiub" and not item.is_virtual and not item.external:
        datasets[path] = item
    else:
        skipped.append(path)


def _unit(dataset: Any) -> str:  # noqa: ANN401
    return next((unit for key in UNIT_ATTRIBUTES if (unit := attribute_text(dataset.attrs.get(key)))), "")


def _piece(dataset: Any, start: int, stop: int) -> np.ndarray[Any, np.dtype[np.float64]]:  # noqa: ANN401
    if dataset.ndim == 1:
        values = dataset[start:stop]
    elif dataset.shape[0] == 1:
        values = dataset[0, start:stop]
    else:
        values = dataset[start:stop, 0]
    return np.ascontiguousarray(values, dtype=np.float64)
