"""Recordings as Parquet: one column per channel, its unit in the metadata of the field, a null for a missing sample.

Library: pyarrow 17 or later, with the versions of the format that it reads and writes. Limits: columns of integers,
floating point numbers and booleans; 2**29 numbers. Columns of other types are skipped.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.stream import Array, RecordingStream, Table, skipped_parts
from piezod.recording.names import TIME, name_columns, unit_of
from piezod.recording.recording import Recording

FOREIGN_KEYS = {b"ARROW:schema", b"pandas"}
"""Metadata keys in which other programs store their own data; not part of a recording's metadata."""


@contextmanager
def open_parquet(path: Path) -> Iterator[RecordingStream]:
    """Open a Parquet file: its schema is read at once, numbers are read with the chunks.

    Raises
    ------
    RecordingError
        pyarrow is not installed, two columns have equal names, or none is `time_s`.
    """
    arrow, parquet = import_library("pyarrow", "parquet", path), import_library("pyarrow.parquet", "parquet", path)
    # No buffering in advance: it would hold the compressed bytes of all wanted columns in memory.
    with parquet.ParquetFile(path, pre_buffer=False) as file:
        fields = list(file.schema_arrow)
        numeric = [field for field in fields if _is_numeric(arrow, field)]
        names = name_columns(path, [(field.name, _unit(field)) for field in numeric])
        stored = dict(zip(names, (field.name for field in numeric), strict=True))

        def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
            columns = [stored[name] for name in wanted]
            for batch in file.iter_batches(batch_size=chunk, columns=columns, use_threads=False):
                if batch.num_rows:
                    yield {name: _values(arrow, batch.column(stored[name])) for name in wanted}

        skipped = [field.name for field in fields if not _is_numeric(arrow, field)]
        yield RecordingStream(
            path, names, chunks, file.metadata.num_rows, _metadata(file.schema_arrow) | skipped_parts(skipped)
        )


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
    return bool(kind.is_floating(field.type) or kind.is_integer(field.type) or kind.is_boolean(field.type))


def _unit(field: Any) -> str:  # noqa: ANN401
    metadata = field.metadata or {}
    return str((metadata.get(b"unit") or metadata.get(b"units") or b"").decode("utf-8", "replace"))


def _metadata(schema: Any) -> dict[str, str]:  # noqa: ANN401
    own = {key: value for key, value in (schema.metadata or {}).items() if key not in FOREIGN_KEYS}
    return {key.decode("utf-8", "replace"): value.decode("utf-8", "replace") for key, value in own.items()}


def _values(arrow: Any, column: Any) -> Array:  # noqa: ANN401
    # safe=False: integers beyond 2**53 are rounded to the nearest double, as in every format
    numbers = column.cast(arrow.float64(), safe=False)
    return np.ascontiguousarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64)
