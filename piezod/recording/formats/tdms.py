"""Recordings as TDMS (LabVIEW): one TDMS channel per column, its unit as the property `unit_string`.

Time is a channel, or follows from the waveform properties `wf_start_time`, `wf_start_offset` and `wf_increment`.
Library: nptdms 1.9 or later, with the versions of the format that it reads. Limits: channels of numbers, all of one
length; one waveform time; 2**29 numbers. Channels of other types and empty channels are skipped.
"""

import io
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import RecordingError
from piezod.recording.formats.access import import_library, replaced_file
from piezod.recording.formats.named_columns import Raw, Stored, named_stream
from piezod.recording.formats.stream import RecordingStream, chunk_ranges, skipped_parts
from piezod.recording.formats.text_layout import TextOptions
from piezod.recording.names import TIME, unit_of
from piezod.recording.recording import Recording

GROUP = "recording"  # name of the group that is written
SEGMENT = 2**16  # samples of each channel in one segment that is written
SHORTEST_CHUNK = 2**20
"""Smallest chunk [samples]: nptdms reads the complete segment for any part of it, and some files have long segments."""


@contextmanager
def open_tdms(path: Path, options: TextOptions) -> Iterator[RecordingStream]:
    """Open a TDMS file: its properties are read at once, numbers are read with the chunks.

    Raises
    ------
    RecordingError
        nptdms is not installed, the channels differ in length, or the file states no time.
    """
    nptdms = import_library("nptdms", "tdms", path)
    nptdms.log.log_manager.set_level(logging.ERROR)  # it would print the content of damaged files
    with _BoundedReader(io.FileIO(path)) as raw, nptdms.TdmsFile.open(raw) as file:
        begins = _begins_of_waveforms(nptdms, path)
        every = [channel for group in file.groups() for channel in group.channels()]
        channels = [channel for channel in every if channel.dtype.kind in "fiubM" and len(channel)]
        skipped = [channel.path for channel in every if channel not in channels]
        metadata = {key: str(value) for key, value in file.properties.items() if isinstance(value, str) and value}
        yield _stream(path, channels, begins, metadata | skipped_parts(skipped), options)


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


Begins = list[tuple[int, Any]]  # (sample, `wf_start_time`) of each session of a waveform


def _begins_of_waveforms(nptdms: Any, path: Path) -> dict[str, Begins]:  # noqa: ANN401
    """Sessions of each channel. nptdms keeps the last start time alone, of a file that was appended to."""
    begins: dict[str, Begins] = {}

    class _Reader(nptdms.reader.TdmsReader):  # type: ignore[misc]
        def _update_object_metadata(self, segment: Any) -> None:  # noqa: ANN401
            self.samples = {path: metadata.num_values for path, metadata in self.object_metadata.items()}
            super()._update_object_metadata(segment)

        def _update_object_properties(self, properties: Any) -> None:  # noqa: ANN401
            for name, pairs in (properties or {}).items():
                for time in [_date(value) for key, value in pairs if key == "wf_start_time"]:
                    sessions = begins.setdefault(name, [])
                    if not sessions or sessions[-1][1] != time:
                        sessions.append((self.samples.get(name, 0), time))
            super()._update_object_properties(properties)

    with _BoundedReader(io.FileIO(path)) as raw:
        _Reader(raw).read_metadata()
    return begins


def _stream(
    path: Path, channels: list[Any], begins: dict[str, Begins], metadata: dict[str, str], options: TextOptions
) -> RecordingStream:
    every = [
        Stored(
            f"{channel.group_name}/{channel.name}",
            len(channel),
            str(channel.properties.get("unit_string", "")),
            channel.name,
            channel.dtype.kind == "M",
        )
        for channel in channels
    ]
    by_path = {stored.path: channel for stored, channel in zip(every, channels, strict=True)}
    wanted = {entry.rpartition("=")[2] for entry in options.columns}
    channels = [channel for path, channel in by_path.items() if not wanted or path in wanted]
    times = [stored for stored in every if stored.is_time and by_path[stored.path] in channels]
    even_time = None if times else _waveform_time(path, channels, begins, metadata)

    def pieces(wanted: Sequence[str], chunk: int) -> Iterator[Raw]:
        for start, stop in chunk_ranges(len(by_path[wanted[0]]), max(chunk, SHORTEST_CHUNK)):
            yield {name: np.asarray(by_path[name].read_data(offset=start, length=stop - start)) for name in wanted}

    return named_stream(path, every, pieces, metadata, options, even_time)


def _waveform_time(
    path: Path, channels: list[Any], begins: dict[str, Begins], metadata: dict[str, str]
) -> Callable[[NDArray[np.int64]], Array] | None:
    """Function from sample numbers to times [s]; None: the channels are no waveforms."""
    waves = [channel for channel in channels if "wf_increment" in channel.properties]
    if not waves:
        return None
    steps = {(float(w.properties.get("wf_start_offset", 0.0)), float(w.properties["wf_increment"])) for w in waves}
    sessions = [begins.get(channel.path, []) for channel in waves]
    offset_s, period_s = steps.pop()
    if steps or not all(_are_equal(session, sessions[0], period_s) for session in sessions):
        starts = [f"{w.name} from {s[0][1] if s else '?'}" for w, s in zip(waves, sessions, strict=True)]
        times = ", ".join(f"{period:g} s from {start:g} s" for start, period in sorted({*steps, (offset_s, period_s)}))
        raise RecordingError(
            f"{path}: waveforms differ in time: {times}; {', '.join(starts)[:200]}; export waveforms of one time"
        )
    first = [sample for sample, _ in sessions[0]] or [0]
    begin_s = [_since(time, sessions[0][0][1]) for _, time in sessions[0]] or [0.0]
    if len(first) > 1:
        gaps = ", ".join(f"{begin_s[k]:.6g} s" for k in range(1, len(first)))
        metadata["time"] = f"the file was appended to: {len(first)} sessions, the others begin at {gaps[:200]}"

    def even_time(samples: NDArray[np.int64]) -> Array:
        session = np.searchsorted(first, samples, side="right") - 1
        start_s = offset_s + np.array(begin_s)[session]
        times_s: Array = start_s + period_s * (samples - np.array(first)[session])
        return times_s

    return even_time


def _are_equal(one: Begins, other: Begins, period_s: float) -> bool:
    """Whether two channels have equal sessions, within a hundredth of a sample."""
    return [sample for sample, _ in one] == [sample for sample, _ in other] and all(
        abs(_since(a, b)) <= 0.01 * period_s for (_, a), (_, b) in zip(one, other, strict=True)
    )


def _date(value: Any) -> Any:  # noqa: ANN401
    """A time of nptdms as datetime64[ns]."""
    return np.array(getattr(value, "as_datetime64", lambda: value)(), "datetime64[ns]")[()]


def _since(time: Any, first: Any) -> float:  # noqa: ANN401
    return float((time - first) / np.timedelta64(1, "ns")) * 1e-9
