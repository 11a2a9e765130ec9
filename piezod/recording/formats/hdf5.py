"""Recordings as HDF5: one dataset per channel, its unit as an attribute, metadata as attributes of the root group.

Library: h5py 3.11 or later; reads every version of the file format that h5py reads, writes the format of HDF5 1.8.
Limits: vectors, the columns of matrices and the fields of tables, in groups of any depth up to 16; 2**29 numbers.
`scale_factor`, `add_offset`, `_FillValue` and `missing_value` are applied (NetCDF Climate and Forecast conventions
1.11, sections 2.5.1 and 8.1); other attributes that may change numbers are named.
A vector of ISO 8601 texts is read as dates. Skipped are external links, external storage and virtual datasets, because
they lead to other files. References, other text and scalars are skipped, because they hold no samples.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.hdf5_heap import check_heaps
from piezod.recording.formats.named_columns import Raw, Stored, named_stream
from piezod.recording.formats.stream import RecordingStream, chunk_ranges, skipped_parts
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME, unit_of
from piezod.recording.recording import Recording

UNIT_ATTRIBUTES = ("unit", "units", "Unit", "Units")
"""Names of the attribute that holds a dataset's unit, in the order in which they are tried."""

MISSING_ATTRIBUTES = ("_FillValue", "missing_value")
UNKNOWN_ATTRIBUTES = ("slope", "intercept", "offset", "gain", "scale", "factor", "sensitivity", "calibration", "lsb")
"""Attributes that may change numbers and have no common meaning."""

TIMING_ATTRIBUTES = (
    *("t0", "start", "start_time", "starttime", "time_offset", "wf_start_time", "wf_start_offset", "delay"),
    *("dt", "interval", "sample_interval", "sampling_rate", "sample_rate", "rate", "wf_increment"),
)
"""Attributes that state start or interval of the samples, in lower case."""

MOST_ATTRIBUTE_BYTES = 2**16
"""Size of an attribute: HDF5 keeps it in the header of its object, which has at most 64 KiB."""

DEEPEST = 16
MOST_COLUMNS = 64  # columns of a matrix that is a table; the longer side counts the samples


class Vector(NamedTuple):
    """A vector of an open file: its dataset, and the column of a matrix or the field of a table."""

    dataset: Any
    part: int | str | None = None

    @property
    def samples(self) -> int:
        """Its length."""
        return int(self.dataset.size if self.part is None or isinstance(self.part, str) else max(self.dataset.shape))

    @property
    def is_date(self) -> bool:
        """Whether it holds dates as text."""
        return self.part is None and self.dataset.dtype.kind in "SO"

    def read(self, start: int, stop: int) -> NDArray[Any]:
        """Stored values of a range, converted by the attributes of the conventions; dates in UTC."""
        dataset = self.dataset
        if self.is_date:
            return np.array([_date(text) for text in dataset[start:stop]], dtype="datetime64[ns]")
        if isinstance(self.part, str):
            return np.ascontiguousarray(dataset[self.part, start:stop])
        if dataset.ndim == 1:
            values = dataset[start:stop]
        elif dataset.shape[0] < dataset.shape[1]:
            values = dataset[self.part or 0, start:stop]
        else:
            values = dataset[start:stop, self.part or 0]
        return _converted(np.ascontiguousarray(values), dataset.attrs)


@contextmanager
def open_hdf5(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
    """Open an HDF5 file: its datasets are listed at once, numbers are read with the chunks.

    Raises
    ------
    RecordingError
        h5py is not installed, the datasets differ in length, or as for `named_stream`.
    """
    h5py = import_library("h5py", "hdf5", path)
    check_heaps(path)
    with h5py.File(path, "r") as file:
        vectors, skipped = vectors_of(h5py, file)
        metadata = {key: text for key in file.attrs if (text := _attribute_text(_attribute(file.attrs, key)))}
        yield stream_of(path, vectors, metadata | skipped_parts(skipped), options)


def stream_of(
    path: Path, vectors: dict[str, Vector], metadata: dict[str, str], options: TextOptions
) -> RecordingStream:
    """Stream of the vectors of an open file, by their paths; errors as for `named_stream`."""

    def pieces(wanted: Sequence[str], chunk: int) -> Iterator[Raw]:
        for start, stop in chunk_ranges(vectors[wanted[0]].samples, chunk):
            yield {name: vectors[name].read(start, stop) for name in wanted}

    unknown = [name for name, vector in vectors.items() if _unknown_attributes(vector.dataset)]
    if unknown:
        attributes = ", ".join(f"{name}: {' '.join(_unknown_attributes(vectors[name].dataset))}" for name in unknown)
        metadata["attributes"] = f"attributes that are not applied: {attributes[:200]}; state them with --scale"
    every = [
        Stored(
            *(name, vector.samples, _unit(vector), name.rpartition("/")[2].replace(":", "_")),
            is_date=vector.is_date,
            of_matrix=isinstance(vector.part, int),
            timing=_timing(vector.dataset),
        )
        for name, vector in vectors.items()
    ]
    return named_stream(path, every, pieces, metadata, options)


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


def vectors_of(h5py: Any, file: Any) -> tuple[dict[str, Vector], list[str]]:  # noqa: ANN401  h5py has no types
    """Vectors of numbers in the groups of a file by their paths, and the paths of the skipped parts.

    Parameters
    ----------
    h5py
        The module h5py.
    file
        Open file of h5py.
    """
    vectors: dict[str, Vector] = {}
    skipped: list[str] = []
    for path, dataset in _datasets(h5py, file["/"], "", skipped, [file["/"]]):
        _add(path, dataset, vectors, skipped)
    return vectors, skipped


def _attribute_text(value: Any) -> str:  # noqa: ANN401  an attribute is of any type
    """Attribute as text; empty for an attribute of another type."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value if isinstance(value, str) else ""


def _datasets(h5py: Any, group: Any, above: str, skipped: list[str], parents: list[Any]) -> Iterator[tuple[str, Any]]:  # noqa: ANN401
    """(path, dataset) of each dataset below a group that is stored in this file; links are added to `skipped`."""
    for name in group:
        path = f"{above}{name}"
        if name.startswith("#"):
            continue  # MATLAB stores its internal objects under such names
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            skipped.append(f"link {path}")
        elif not isinstance(item := group[name], h5py.Group):
            yield path, item
        elif item in parents or len(parents) > DEEPEST:
            skipped.append(path)
        else:
            yield from _datasets(h5py, item, f"{path}/", skipped, [*parents, item])


def _add(path: str, dataset: Any, vectors: dict[str, Vector], skipped: list[str]) -> None:  # noqa: ANN401
    """Add the vectors of a dataset, or the dataset to the skipped parts."""
    shape = getattr(dataset, "shape", None) or ()
    if not shape or dataset.size < 1 or dataset.is_virtual or dataset.external:
        skipped.append(path)
    elif dataset.dtype.names and len(shape) == 1:
        fields = [name for name in dataset.dtype.names if dataset.dtype[name].kind in "fiub"]
        vectors |= {f"{path}/{name}": Vector(dataset, name) for name in fields}
        skipped += [f"{path}/{name}" for name in dataset.dtype.names if name not in fields]
    elif dataset.dtype.kind not in "fiub":
        if len(shape) == 1 and _holds_dates(dataset):
            vectors[path] = Vector(dataset)
        else:
            skipped.append(path)
    elif len(shape) < 3 and dataset.size in shape:
        vectors[path] = Vector(dataset)
    elif len(shape) == 2 and min(shape) <= MOST_COLUMNS:
        vectors |= {f"{path}:{k + 1}": Vector(dataset, k) for k in range(min(shape))}
    else:
        skipped.append(path)


def _holds_dates(dataset: Any) -> bool:  # noqa: ANN401
    """Whether a dataset holds text, and its first and last texts are dates."""
    is_text = dataset.dtype.kind == "S" or (dataset.dtype.metadata is not None and "vlen" in dataset.dtype.metadata)
    return is_text and not any(np.isnat(_date(dataset[k])) for k in (0, -1))


def _date(text: object) -> np.datetime64:
    """Date and time of ISO 8601, in UTC where a zone is stated; "not a time" for another text."""
    try:
        date = datetime.fromisoformat(_attribute_text(text).strip())
    except ValueError:
        return np.datetime64("NaT")
    return np.datetime64(date.astimezone(UTC).replace(tzinfo=None) if date.tzinfo else date, "ns")


def _converted(values: NDArray[Any], attributes: Any) -> NDArray[Any]:  # noqa: ANN401
    """Values by `scale_factor` and `add_offset`, nan for fill values; as stored without these attributes."""
    missing = [value for key in MISSING_ATTRIBUTES if (value := _number(_attribute(attributes, key))) is not None]
    factor, offset = (_number(_attribute(attributes, key)) for key in ("scale_factor", "add_offset"))
    if factor is None and offset is None and not missing:
        return values
    numbers = values * (1.0 if factor is None else factor) + (0.0 if offset is None else offset)
    return np.where(np.isin(values, np.asarray(missing, dtype=values.dtype)), np.nan, numbers) if missing else numbers


def _attribute(attributes: Any, key: str) -> Any:  # noqa: ANN401
    """Value of an attribute; None where it is absent, or claims more bytes than an attribute needs."""
    if key not in attributes:
        return None
    stored = attributes.get_id(key)
    return attributes[key] if stored.dtype.itemsize * prod(stored.shape or ()) <= MOST_ATTRIBUTE_BYTES else None


def _number(value: Any) -> float | None:  # noqa: ANN401
    """An attribute as a number, also of text; None: it is none."""
    try:
        return float(np.asarray(_attribute_text(value) or value).ravel()[0])
    except (TypeError, ValueError, IndexError):
        return None


def _unknown_attributes(dataset: Any) -> list[str]:  # noqa: ANN401
    """Attributes that may change the numbers and are not applied."""
    applied = ("scale_factor", "add_offset", *MISSING_ATTRIBUTES)
    return [
        key
        for key in dataset.attrs
        if (key in applied and _number(_attribute(dataset.attrs, key)) is None)
        or (key not in applied and key.lower().split("_")[0] in UNKNOWN_ATTRIBUTES)
    ]


def _timing(dataset: Any) -> str:  # noqa: ANN401
    """Start and interval of the samples by the attributes."""
    stated = ((key, _attribute(dataset.attrs, key)) for key in dataset.attrs if key.lower() in TIMING_ATTRIBUTES)
    return ", ".join(f"{key} = {_attribute_text(value) or value!s:.40}" for key, value in stated)


def _unit(vector: Vector) -> str:
    if vector.part is not None:
        return ""
    return next(
        (unit for key in UNIT_ATTRIBUTES if (unit := _attribute_text(_attribute(vector.dataset.attrs, key)))), ""
    )
