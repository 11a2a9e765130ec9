"""Recordings as Parquet: one column a channel, its unit in the field's metadata, a null for a missing sample."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.recording.formats.stream import Array, Source, Table, replacing, require, skipped
from piezod.recording.names import TIME, name_columns, unit_of
from piezod.recording.recording import Recording

FOREIGN_KEYS = {b"ARROW:schema", b"pandas"}
"""Metadata that other programs keep for themselves."""


@contextmanager
def open_parquet(path: Path) -> Iterator[Source]:
    """Open a Parquet file: its schema is read, its numbers not yet.

    Raises
    ------
    RecordingError
        pyarrow is missing, or the columns are no recording.
    """
    arrow, parquet = require("pyarrow", "parquet", path), require("pyarrow.parquet", "parquet", path)
    # Not buffered ahead: that would hold all of the file's columns that are wanted, packed, beside the numbers
    with parquet.ParquetFile(path, pre_buffer=False) as file:
        fields = list(file.schema_arrow)
        number = [_is_number(arrow, field) for field in fields]
        wanted_fields = [field for field, good in zip(fields, number, strict=True) if good]
        names = name_columns(path, [(field.name, _unit(field)) for field in wanted_fields])
        stored = dict(zip(names, (field.name for field in wanted_fields), strict=True))

        def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
            columns = [stored[name] for name in wanted]
            for batch in file.iter_batches(batch_size=chunk, columns=columns, use_threads=False):
                if batch.num_rows:
                    yield {name: _values(arrow, batch.column(stored[name])) for name in wanted}

        left_out = [field.name for field, good in zip(fields, number, strict=True) if not good]
        yield Source(path, names, chunks, file.metadata.num_rows, _metadata(file.schema_arrow) | skipped(left_out))


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all; exact.

    Raises
    ------
    RecordingError
        pyarrow is missing, or the file cannot be written.
    """
    arrow, parquet = require("pyarrow", "parquet", path), require("pyarrow.parquet", "parquet", path)
    columns = {TIME: recording.time_s, **recording.channels}
    fields = [arrow.field(name, arrow.float64(), metadata={"unit": unit_of(name)}) for name in columns]
    table = arrow.Table.from_arrays(
        [arrow.array(np.asarray(values, dtype=np.float64)) for values in columns.values()],
        schema=arrow.schema(fields, metadata=recording.metadata),
    )
    with replacing(path) as temporary:
        parquet.write_table(table, temporary)


def _is_number(arrow: Any, field: Any) -> bool:  # noqa: ANN401
    kind = arrow.types
    return bool(kind.is_floating(field.type) or kind.is_integer(field.type) or kind.is_boolean(field.type))


def _unit(field: Any) -> str:  # noqa: ANN401
    said = field.metadata or {}
    return str((said.get(b"unit") or said.get(b"units") or b"").decode("utf-8", "replace"))


def _metadata(schema: Any) -> dict[str, str]:  # noqa: ANN401
    said = {key: value for key, value in (schema.metadata or {}).items() if key not in FOREIGN_KEYS}
    return {key.decode("utf-8", "replace"): value.decode("utf-8", "replace") for key, value in said.items()}


def _values(arrow: Any, column: Any) -> Array:  # noqa: ANN401
    # safe=False: integers beyond 2^53 round to the nearest double, as everywhere else
    numbers = column.cast(arrow.float64(), safe=False)
    return np.ascontiguousarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64)
