"""Recordings as MDF 4 (ASAM): one MDF channel per column with its unit, time from the master channel of the group.

Library: asammdf 8 or later; reads versions 4.x, writes 4.10. Limits: finalised files; one time axis for all groups;
2**29 numbers; the file is read completely into memory. A channel with a formula is skipped, because no text from a
file is ever evaluated. A channel of text is skipped too.
"""

import html
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.mdf4_blocks import check_blocks
from piezod.recording.formats.named_columns import Raw, Stored, named_stream
from piezod.recording.formats.stream import RecordingStream, common_length, skipped_parts
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME, channel_name, unit_of
from piezod.recording.recording import Recording

PLAIN_CONVERSIONS = {0, 1, 2, 4, 5, 6}
"""Conversions that are accepted: none, linear, rational and tables of numbers (cc_type, MDF 4.1).

Not accepted are 3, an algebraic formula, and all conversions to text.
"""

NUMBERS = {0, 1, 2, 3, 4, 5}
"""Data types that are accepted: unsigned, signed and floating point in both byte orders (cn_data_type, MDF 4.1)."""


@contextmanager
def open_mdf4(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
    """Open an MDF 4 file: its structure is checked and read at once, numbers are read with the only chunk.

    Parameters
    ----------
    path
        MDF 4 file.

    Raises
    ------
    RecordingError
        asammdf is not installed, the blocks are damaged, or the groups differ in length.
    """
    asammdf = import_library("asammdf", "mdf", path)
    check_blocks(path)
    # An open file instead of a path: asammdf maps a path to memory and prints to stderr after an error.
    with path.open("rb") as raw, asammdf.MDF(raw) as file:
        columns, skipped = _columns(file)
        yield _stream(path, file, columns, _metadata(file.header.comment) | skipped_parts(skipped), options)


def write_mdf4(recording: Recording, path: Path) -> None:
    """Write a recording without loss; an error leaves an existing file unchanged.

    Parameters
    ----------
    recording
        Recording to write, with at least one channel.

    Raises
    ------
    RecordingError
        asammdf is not installed, the recording has no channel, or the file cannot be written.
    """
    asammdf = import_library("asammdf", "mdf", path)
    if not recording.channels:
        raise RecordingError(f"{path}: cannot be written: has no channels, a group of MDF must have one")
    with replaced_file(path) as temporary, asammdf.MDF(version="4.10") as file:
        signals = [
            asammdf.Signal(np.asarray(values, dtype=np.float64), recording.time_s, name=name, unit=unit_of(name))
            for name, values in recording.channels.items()
        ]
        file.append(signals, common_timebase=True)
        file.header.comment = "\n".join(f"{key}: {' '.join(v.split())}" for key, v in recording.metadata.items())
        file.save(temporary, overwrite=True)


def _columns(file: Any) -> tuple[dict[tuple[int, int], tuple[str, str]], list[str]]:  # noqa: ANN401
    """(name, unit) of every accepted channel by (group, index), and the names of the skipped channels."""
    columns: dict[tuple[int, int], tuple[str, str]] = {}
    skipped: list[str] = []
    for group, content in enumerate(file.groups):
        master = file.masters_db.get(group)
        for index, channel in enumerate(content.channels):
            if index == master or not content.channel_group.cycles_nr:
                continue
            record = content.channel_group.samples_byte_nr
            if master is not None and _is_plain(channel, record) and _is_plain(content.channels[master], record):
                columns[group, index] = (channel.name, channel.unit or "")
            else:
                skipped.append(channel.name)
    return columns, skipped


def _is_plain(channel: Any, record: int) -> bool:  # noqa: ANN401
    """Whether a channel holds numbers within a record of `record` bytes; asammdf itself does not check this."""
    end = channel.byte_offset + (channel.bit_offset + channel.bit_count + 7) // 8
    conversion = 0 if channel.conversion is None else channel.conversion.conversion_type
    return end <= record and channel.data_type in NUMBERS and conversion in PLAIN_CONVERSIONS


def _stream(
    path: Path,
    file: Any,  # noqa: ANN401  asammdf has no types
    columns: dict[tuple[int, int], tuple[str, str]],
    metadata: dict[str, str],
    options: TextOptions,
) -> RecordingStream:
    named = {place: column for place, column in columns.items() if channel_name(*column) != TIME}
    count = Counter(name for name, _ in named.values())
    places = {name if count[name] == 1 else f"group {place[0] + 1}/{name}": place for place, (name, _) in named.items()}
    groups = sorted({group for group, _ in named})
    samples = common_length(
        path, {f"group {group + 1}": int(file.groups[group].channel_group.cycles_nr) for group in groups}
    )

    def pieces(wanted: Sequence[str], _: int) -> Iterator[Raw]:
        # asammdf reads the complete group for any part of it: smaller chunks would save no memory and take longer.
        times = [np.asarray(file.get_master(group), dtype=np.float64) for group in groups]
        if any(not np.array_equal(time_s, times[0]) for time_s in times[1:]):
            raise RecordingError(f"{path}: its groups are sampled at different times; export one group")
        if samples:
            yield {name: times[0] if name == TIME else _values(file, places[name]) for name in wanted}

    every = [Stored(name, samples, named[place][1], named[place][0]) for name, place in places.items()]
    times = [Stored(TIME, samples, "", TIME)] if every else []
    return named_stream(path, every + times, pieces, metadata, options)


def _values(file: Any, place: tuple[int, int]) -> Array:  # noqa: ANN401
    """Samples of a channel in its unit; nan for samples that the file marks as invalid."""
    group, index = place
    signal = file.get(group=group, index=index, ignore_invalidation_bits=True)
    values = np.array(signal.samples, dtype=np.float64)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits, dtype=bool)] = np.nan
    return values


def _metadata(comment: str) -> dict[str, str]:
    """Metadata from the lines `key: value` of a file's comment, which is plain text or XML."""
    text = re.search(r"<TX[^>]*>(.*?)</TX>", comment, re.DOTALL)
    lines = html.unescape(text[1] if text else "" if comment.startswith("<") else comment).split("\n")
    pairs = (line.partition(": ") for line in lines if ": " in line)
    return {key.strip(): value.strip() for key, _, value in pairs}
