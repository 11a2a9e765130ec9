"""Recordings as HDF5: one dataset a channel, its unit as an attribute, metadata as attributes of the root.

Datasets are looked for in the root and in groups directly below it. What would lead out of the file (external links,
external storage, virtual datasets) and what holds no numbers (references, text, tables) is left out.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.recording.formats.hdf5_heap import check_heaps
from piezod.recording.formats.stream import Source, Table, one_length, replacing, require, skipped, spans
from piezod.recording.names import TIME, name_columns, unit_of
from piezod.recording.recording import Recording

UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")


@contextmanager
def open_hdf5(path: Path) -> Iterator[Source]:
    """Open an HDF5 file: its datasets are found, their numbers not yet read.

    Raises
    ------
    RecordingError
        h5py is missing, or the datasets are no recording.
    """
    h5py = require("h5py", "hdf5", path)
    check_heaps(path)
    with h5py.File(path, "r") as file:
        datasets, left_out = numbers(h5py, file)
        metadata = {key: said for key in file.attrs if (said := text(file.attrs.get(key)))}
        yield columns_of(path, datasets, metadata | skipped(left_out))


def columns_of(path: Path, datasets: dict[str, Any], metadata: dict[str, str]) -> Source:
    """A source whose columns are these datasets, vectors or matrices of one row or column."""
    names = name_columns(path, [(name, _unit(dataset)) for name, dataset in datasets.items()])
    vectors = dict(zip(names, datasets.values(), strict=True))
    samples = one_length(path, {name: int(vector.size) for name, vector in vectors.items()})

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        for start, stop in spans(samples, chunk):
            yield {name: _piece(vectors[name], start, stop) for name in wanted}

    return Source(path, names, chunks, samples, metadata)


def write_hdf5(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all; exact.

    Raises
    ------
    RecordingError
        h5py is missing, or the file cannot be written.
    """
    h5py = require("h5py", "hdf5", path)
    with replacing(path) as temporary, h5py.File(temporary, "w", libver=("v108", "latest"), track_order=True) as file:
        for key, value in recording.metadata.items():
            file.attrs[key] = value
        for name, values in {TIME: recording.time_s, **recording.channels}.items():
            dataset = file.create_dataset(name, data=np.asarray(values, dtype=np.float64))
            dataset.attrs["unit"] = unit_of(name)


def numbers(h5py: Any, file: Any) -> tuple[dict[str, Any], list[str]]:  # noqa: ANN401  h5py has no types
    """Datasets of numbers in the root and one level below, by path, and the paths of what is left out."""
    found: dict[str, Any] = {}
    left_out: list[str] = []
    for path, item in _items(h5py, file, left_out):
        if isinstance(item, h5py.Group) and item != file["/"]:
            for below, dataset in _items(h5py, item, left_out):
                _sort(h5py, f"{path}/{below}", dataset, found, left_out)
        else:
            _sort(h5py, path, item, found, left_out)
    names = {path: path.rpartition("/")[2] for path in found}
    often = Counter(names.values())
    return {name if often[name] == 1 else path: found[path] for path, name in names.items()}, left_out


def text(value: Any) -> str:  # noqa: ANN401  an attribute is of any type
    """Attribute as text, empty if it is none."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""


def _items(h5py: Any, group: Any, left_out: list[str]) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """Members of a group that lie in this file: links to elsewhere are not followed."""
    for name in group:
        if name.startswith("#"):
            continue  # MATLAB's own
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            yield name, group[name]
        else:
            left_out.append(f"link {name}")


def _sort(h5py: Any, path: str, item: Any, found: dict[str, Any], left_out: list[str]) -> None:  # noqa: ANN401
    vector = isinstance(item, h5py.Dataset) and item.ndim in {1, 2} and item.size in item.shape
    if vector and item.dtype.kind in "fiub" and not item.is_virtual and not item.external:
        found[path] = item
    else:
        left_out.append(path)


def _unit(dataset: Any) -> str:  # noqa: ANN401
    return next((said for key in UNIT_ATTRIBUTES if (said := text(dataset.attrs.get(key)))), "")


def _piece(dataset: Any, start: int, stop: int) -> np.ndarray[Any, np.dtype[np.float64]]:  # noqa: ANN401
    if dataset.ndim == 1:
        values = dataset[start:stop]
    elif dataset.shape[0] == 1:
        values = dataset[0, start:stop]
    else:
        values = dataset[start:stop, 0]
    return np.ascontiguousarray(values, dtype=np.float64)
