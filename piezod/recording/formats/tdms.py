"""Recordings as TDMS (LabVIEW): one channel a column, its unit as `unit_string`, time as channel or waveform step."""

import io
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.formats.stream import Array, Source, Table, one_length, replacing, require, skipped, spans
from piezod.recording.names import TIME, channel_name, name_columns, unit_of
from piezod.recording.recording import Recording

GROUP = "recording"

SEGMENT = 2**16
"""Samples of each channel in one segment of a file written."""

READ = 2**20
"""Samples read at once: nptdms reads a whole segment to cut a part from it, and others write long ones."""


@contextmanager
def open_tdms(path: Path) -> Iterator[Source]:
    """Open a TDMS file: its properties are read, its numbers not yet.

    Raises
    ------
    RecordingError
        nptdms is missing, the channels differ in length or name no time.
    """
    nptdms = require("nptdms", "tdms", path)
    nptdms.log.log_manager.set_level(logging.ERROR)  # of damaged text it would print whole files
    with _AsLongAsItIs(io.FileIO(path)) as raw, nptdms.TdmsFile.open(raw) as file:
        every = [channel for group in file.groups() for channel in group.channels()]
        channels = [channel for channel in every if channel.dtype.kind in "fiub" and len(channel)]
        left_out = [channel.path for channel in every if channel not in channels]
        metadata = {key: str(value) for key, value in file.properties.items() if isinstance(value, str) and value}
        yield _source(path, channels, metadata | skipped(left_out))


def write_tdms(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all; exact.

    Raises
    ------
    RecordingError
        nptdms is missing, or the file cannot be written.
    """
    nptdms = require("nptdms", "tdms", path)
    columns = {TIME: recording.time_s, **recording.channels}
    root = nptdms.RootObject(properties=dict(recording.metadata))
    units = {name: {"unit_string": unit_of(name)} for name in columns}
    with replacing(path) as temporary, nptdms.TdmsWriter(temporary) as file:
        file.write_segment([root])
        for start, stop in spans(recording.time_s.size, SEGMENT):
            file.write_segment(
                nptdms.ChannelObject(GROUP, name, np.asarray(values[start:stop], dtype=np.float64), units[name])
                for name, values in columns.items()
            )


class _AsLongAsItIs(io.BufferedReader):
    """A file that is never asked for more than it has: a length in a damaged one may claim 4 GB, and get them."""

    def read(self, size: int | None = -1) -> bytes:
        """Read at most what is left."""
        if size is None or size < 0:
            return super().read()
        here = self.tell()
        left = self.seek(0, io.SEEK_END) - here
        self.seek(here)
        return super().read(min(size, max(left, 0)))


def _source(path: Path, channels: list[Any], metadata: dict[str, str]) -> Source:
    columns = [(channel.name, str(channel.properties.get("unit_string", ""))) for channel in channels]
    own_time = any(channel_name(*column) == TIME for column in columns)
    step = None if own_time else _waveform_step(path, channels)
    names = name_columns(path, columns if step is None else [*columns, (TIME, "")])
    found = dict(zip(names, channels, strict=False))
    samples = one_length(path, {name: len(channel) for name, channel in found.items()})

    def chunks(wanted: Sequence[str], chunk: int) -> Iterator[Table]:
        for start, stop in spans(samples, max(chunk, READ)):
            yield {name: _piece(found.get(name), step, start, stop) for name in wanted}

    return Source(path, names, chunks, samples, metadata)


def _waveform_step(path: Path, channels: list[Any]) -> tuple[float, float] | None:
    """First time and period [s] of the waveforms, None if they have none."""
    steps = {
        (float(channel.properties.get("wf_start_offset", 0.0)), float(channel.properties["wf_increment"]))
        for channel in channels
        if "wf_increment" in channel.properties
    }
    if len(steps) > 1:
        said = ", ".join(f"{period:g} s from {start:g} s" for start, period in sorted(steps))
        raise RecordingError(f"{path}: waveforms differ in time: {said}; export those of one time")
    return next(iter(steps), None)


def _piece(channel: Any, step: tuple[float, float] | None, start: int, stop: int) -> Array:  # noqa: ANN401
    if channel is None and step is not None:
        return step[0] + step[1] * np.arange(start, stop, dtype=np.float64)
    return np.ascontiguousarray(channel.read_data(offset=start, length=stop - start), dtype=np.float64)
