"""Recordings as Parquet: one column per channel, its unit in the metadata of the field, a null for a missing sample.

Library: pyarrow 17 or later, with the versions of the format that it reads and writes. Limits: columns of integers,
floating point numbers, booleans and dates; 2**29 numbers. Columns of other types are skipped.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.named_columns import Raw, Stored, named_stream
from piezod.recording.formats.stream import RecordingStream, skipped_parts
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME, unit_of
from piezod.recording.recording import Recording

FOREIGN_KEYS = {b"ARROW:schema", b"pandas"}
"""Metadata keys in which other programs store their own data; not part of a recording's metadata."""


@contextmanager
def open_parquet(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
    """Open a Parquet file: its schema is read at once, numbers are read with the chunks.

    Raises
    ------
    RecordingError
        pyarrow is not installed, two columns have equal names, or as for `named_stream`.
    """
    arrow, parquet = import_library("pyarrow", "parquet", path), import_library("pyarrow.parquet", "parquet", path)
    # No buffering in advance: it would hold the compressed bytes of all wanted columns in memory.
    with parquet.ParquetFile(path, pre_buffer=False) as file:
        schema, samples = file.schema_arrow, file.metadata.num_rows
        fields = [field for field in schema if _is_numeric(arrow, field)]
        every = [
            Stored(field.name, samples, _unit(arrow, field), field.name, arrow.types.is_timestamp(field.type))
            for field in fields
        ]

        def pieces(wanted: Sequence[str], chunk: int) -> Iterator[Raw]:
            for batch in file.iter_batches(batch_size=chunk, columns=list(dict.fromkeys(wanted)), use_threads=False):
                if batch.num_rows:
                    yield {name: _values(arrow, batch.column(name)) for name in wanted}

        skipped = [field.name for field in schema if field not in fields]
        yield named_stream(path, every, pieces, _metadata(schema) | skipped_parts(skipped), options)


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a recording without loss; an error leaves an existing file unchanged.

    Raises
    ------
    RecordingError
        pyarrow is not installed, or the file cannot be written.
    """
    arrow, parquet = import_library("pyarrow", "parquet", path), import_library("pyarrow.parquet", "parquet", path)
    columns = {TIME: recording.time_s, **recording.channels}
    fields = [arrow.field(name, arrow.float64(), metadata={"unit": unit_of(name)}) for name in columns]
    table = arrow.Table.from_arrays(
        [arrow.array(np.asarray(values, dtype=np.float64)) for values in columns.values()],
        schema=arrow.schema(fields, metadata=recording.metadata),
    )
    with replaced_file(path) as temporary:
        parquet.write_table(table, temporary)


def _is_numeric(arrow: Any, field: Any) -> bool:  # noqa: ANN401
    kind = arrow.types
    tests = (kind.is_floating, kind.is_integer, kind.is_boolean, kind.is_timestamp, kind.is_duration)
    return any(test(field.type) for test in tests)


def _unit(arrow: Any, field: Any) -> str:  # noqa: ANN401
    if arrow.types.is_duration(field.type):
        return "s"
    metadata = field.metadata or {}
    return str((metadata.get(b"unit") or metadata.get(b"units") or b"").decode("utf-8", "replace"))


def _metadata(schema: Any) -> dict[str, str]:  # noqa: ANN401
    own = {key: value for key, value in (schema.metadata or {}).items() if key not in FOREIGN_KEYS}
    return {key.decode("utf-8", "replace"): value.decode("utf-8", "replace") for key, value in own.items()}


def _values(arrow: Any, column: Any) -> NDArray[Any]:  # noqa: ANN401
    """Dates in UTC, durations in seconds, whole numbers without a null as they are, else floating point numbers."""
    if arrow.types.is_timestamp(column.type):
        dates = column.cast(arrow.timestamp("ns")).to_numpy(zero_copy_only=False)
        return np.asarray(dates, dtype="datetime64[ns]")
    if arrow.types.is_duration(column.type):
        column = column.cast(arrow.duration("ns")).cast(arrow.int64())
        return np.ascontiguousarray(1e-9 * column.cast(arrow.float64()).to_numpy(zero_copy_only=False))
    if arrow.types.is_integer(column.type) and not column.null_count:
        return np.asarray(column.to_numpy(zero_copy_only=False))
    # safe=False: integers beyond 2**53 are rounded to the nearest double, as in every format
    numbers = column.cast(arrow.float64(), safe=False)
    return np.ascontiguousarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64)
