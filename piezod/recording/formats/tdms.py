"""Recordings as TDMS (LabVIEW): one TDMS channel per column, its unit as the property `unit_string`.

Time is a channel `time_s`, or follows from the waveform properties `wf_start_offset` and `wf_increment`. Library:
nptdms 1.9 or later, with the versions of the format that it reads. Limits: channels of real numbers, all of one
length; one waveform time; 2**29 numbers. Channels of other types and empty channels are skipped.
"""

import io
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.stream import Array, RecordingStream, Table, chunk_ranges, common_length, skipped_parts
from piezod.recording.names import TIME, channel_name, name_columns, unit_of
from piezod.recording.recording import Recording

GROUP = "recording"
"""Name of the group that is written."""

SEGMENT = 2**16
"""Samples of each channel in one segment that is written."""

SHORTEST_CHUNK = 2**20
"""Smallest chunk [samples]: nptdms reads the complete segment for any part of it, and some files have long segments."""


@contextmanager
def open_tdms(path: Path) -> Iterator[RecordingStream]:
    """Open a TDMS file: its properties are read at once, numbers are read with the chunks.

    Raises
    ------
    RecordingError
        nptdms is not installed, the channels differ in length, or the file states no time.
    """
    nptdms = import_library("nptdms", "tdms", path)
    nptdms.log.log_manager.set_level(logging.ERROR)  # it would print the content of damaged files
    with _BoundedReader(io.FileIO(path)) as raw, nptdms.TdmsFile.open(raw) as file:
        every = [channel for group in file.groups() for channel in group.channels()]
        channels = [channel for channel in every if channel.dtype.kind in "fiub" and len(channel)]
        skipped = [channel.path for channel in every if channel not in channels]
        metadata = {key: str(value) for key, value in file.properties.items() if isinstance(value, str) and value}
        yield _stream(path, channels, metadata | skipped_parts(skipped))


def write_tdms(recording: Recording, path: Path) -> None:
    """Write a recording without loss; an error leaves an existing file unchanged.

    Raises
    ------
    RecordingError
        nptdms is not installed, or the file cannot be written.
    """
    nptdms = import_library("nptdms", "tdms", path)
    columns = {TIME: recording.time_s, **recording.channels}
    root = nptdms.RootObject(properties=dict(recording.metadata))
    units = {name: {"unit_string": unit_of(name)} for name in columns}
    with replaced_file(path) as temporary, nptdms.TdmsWriter(temporary) as file:
        file.write_segment([root])
        for start, stop in chunk_ranges(recording.time_s.size, SEGMENT):
            file.write_segment(
                nptdms.ChannelObject(GROUP, name, np.asarray(values[start:stop], dtype=np.float64), units[name])
                for name, values in columns.items()
            )


class _BoundedReader(io.BufferedReader):
    """File whose reads are limited to its size.

    Python allocates the requested size before it reads, and a damaged file may request 4 GB.
    """

    def read(self, size: int | None = -1) -> bytes:
        """Read `size` bytes, or as many as the file still holds."""
        if size is None or size < 0:
            return super().read()
        position = self.tell()
        remaining = self.seek(0, io.SEEK_END) - position
        self.seek(position)
        return super().read(min(size, max(remaining, 0)))


def _stream(path: Path, channels: list[Any], metadata: dict[str, str]) -> RecordingStream:
    columns = [(channel.name, str(channel.properties.get("unit_string", ""))) for channel in channels]
    own_time = any(channel_name(*column) == TIME for column in columns)
    step = None if own_time else _waveform_step(path, channels)
    names = name_columns(path, columns if step is None else [*columns, (TIME, "")])
    by_name = dict(zip(names, channels, strict=False))
    samples = common_length(path, {name: len(channel) for name, channel in by_name.items()})

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        for start, stop in chunk_ranges(samples, max(chunk, SHORTEST_CHUNK)):
            yield {name: _piece(by_name.get(name), step, start, stop) for name in wanted}

    return RecordingStream(path, names, chunks, samples, metadata)


def _waveform_step(path: Path, channels: list[Any]) -> tuple[float, float] | None:
    """(start [s], period [s]) of the waveforms; None: the channels are no waveforms."""
    steps = {
        (float(channel.properties.get("wf_start_offset", 0.0)), float(channel.properties["wf_increment"]))
        for channel in channels
        if "wf_increment" in channel.properties
    }
    if len(steps) > 1:
        times = ", ".join(f"{period:g} s from {start:g} s" for start, period in sorted(steps))
        raise RecordingError(f"{path}: waveforms differ in time: {times}; export waveforms of one time")
    return next(iter(steps), None)


def _piece(channel: Any, step: tuple[float, float] | None, start: int, stop: int) -> Array:  # noqa: ANN401
    if channel is None and step is not None:
        return step[0] + step[1] * np.arange(start, stop, dtype=np.float64)
    return np.ascontiguousarray(channel.read_data(offset=start, length=stop - start), dtype=np.float64)
