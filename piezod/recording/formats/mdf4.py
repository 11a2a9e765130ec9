"""Recordings as MDF 4 (ASAM): one channel a column with its unit, time from the group's master channel.

Channels that are computed by a formula in the file are left out: no text from a file is ever evaluated.
"""

import html
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.mdf4_blocks import check_blocks
from piezod.recording.formats.stream import Array, Source, Table, one_length, replacing, require, skipped
from piezod.recording.names import TIME, channel_name, name_columns, unit_of
from piezod.recording.recording import Recording

PLAIN_CONVERSIONS = {0, 1, 2, 4, 5, 6}
"""none, linear, rational and tables of numbers (cc_type, MDF 4.1); not 3, an algebraic formula, nor any to text."""

NUMBERS = {0, 1, 2, 3, 4, 5}
"""Unsigned, signed and floating point, of either byte order (cn_data_type, MDF 4.1)."""


@contextmanager
def open_mdf4(path: Path) -> Iterator[Source]:
    """Open an MDF 4 file: its blocks are read, its numbers not yet.

    Raises
    ------
    RecordingError
        asammdf is missing, the blocks are damaged, or the channels are no recording.
    """
    asammdf = require("asammdf", "mdf", path)
    check_blocks(path)
    # An open file: a path, asammdf maps to memory, and says so on stderr when it fails half-way
    with path.open("rb") as raw, asammdf.MDF(raw) as file:
        columns, left_out = _columns(file)
        yield _source(path, file, columns, _metadata(file.header.comment) | skipped(left_out))


def write_mdf4(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all; exact.

    Raises
    ------
    RecordingError
        asammdf is missing, there is no channel, or the file cannot be written.
    """
    asammdf = require("asammdf", "mdf", path)
    if not recording.channels:
        raise RecordingError(f"{path}: cannot be written: has no channels, a group of MDF needs one")
    with replacing(path) as temporary, asammdf.MDF(version="4.10") as file:
        signals = [
            asammdf.Signal(np.asarray(values, dtype=np.float64), recording.time_s, name=name, unit=unit_of(name))
            for name, values in recording.channels.items()
        ]
        file.append(signals, common_timebase=True)
        file.header.comment = "\n".join(f"{key}: {' '.join(v.split())}" for key, v in recording.metadata.items())
        file.save(temporary, overwrite=True)


def _columns(file: Any) -> tuple[dict[tuple[int, int], tuple[str, str]], list[str]]:  # noqa: ANN401
    """(name, unit) of every channel of plain numbers by (group, index), and the names of those left out."""
    columns: dict[tuple[int, int], tuple[str, str]] = {}
    left_out: list[str] = []
    for group, content in enumerate(file.groups):
        master = file.masters_db.get(group)
        for index, channel in enumerate(content.channels):
            if index == master or not content.channel_group.cycles_nr:
                continue
            record = content.channel_group.samples_byte_nr
            if master is not None and _is_plain(channel, record) and _is_plain(content.channels[master], record):
                columns[group, index] = (channel.name, channel.unit or "")
            else:
                left_out.append(channel.name)
    return columns, left_out


def _is_plain(channel: Any, record: int) -> bool:  # noqa: ANN401
    """Whether it is numbers that lie within a record of that many bytes: asammdf reads beyond its end unasked."""
    end = channel.byte_offset + (channel.bit_offset + channel.bit_count + 7) // 8
    conversion = 0 if channel.conversion is None else channel.conversion.conversion_type
    return end <= record and channel.data_type in NUMBERS and conversion in PLAIN_CONVERSIONS


def _source(path: Path, file: Any, columns: dict[tuple[int, int], tuple[str, str]], said: dict[str, str]) -> Source:  # noqa: ANN401
    named = {place: column for place, column in columns.items() if channel_name(*column) != TIME}
    names = name_columns(path, [*named.values(), *([(TIME, "")] if columns else [])])
    places = dict(zip(names, named, strict=False))
    groups = sorted({group for group, _ in named})
    samples = one_length(
        path, {f"group {group + 1}": int(file.groups[group].channel_group.cycles_nr) for group in groups}
    )

    def chunks(wanted: Sequence[str], _: int) -> Iterator[Table]:
        # asammdf reads the whole group to cut a part from it: parts would not spare memory and take longer
        times = [np.asarray(file.get_master(group), dtype=np.float64) for group in groups]
        if any(not np.array_equal(time_s, times[0]) for time_s in times[1:]):
            raise RecordingError(f"{path}: its groups are sampled at different times; export one of them")
        if samples:
            yield {name: times[0] if name == TIME else _values(file, places[name]) for name in wanted}

    return Source(path, names, chunks, samples, said)


def _values(file: Any, place: tuple[int, int]) -> Array:  # noqa: ANN401
    """Samples of a channel in its unit; nan where the file marks them invalid."""
    group, index = place
    signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
    values = np.array(signal.samples, dtype=np.float64)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
    return values


def _metadata(comment: str) -> dict[str, str]:
    """`key: value` lines of a file's comment, which may be XML."""
    text = re.search(r"<TX[^>]*>(.*?)</TX>", comment, re.DOTALL)
    lines = html.unescape(text[1] if text else "" if comment.startswith("<") else comment).split("\n")
    pairs = (line.partition(": ") for line in lines if ": " in line)
    return {key.strip(): value.strip() for key, _, value in pairs}
