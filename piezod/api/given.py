"""Recordings as arguments: the path of a file, a `Recording`, or a pandas frame."""

import hashlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from piezod.errors import UsageError
from piezod.estimation.recordings.intake import LoadedRecording, OnStep, load_recordings, usable
from piezod.model import file_sha256
from piezod.recording import Recording, TextOptions, column_names, read_recording
from piezod.recording.conversion import in_units_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

Given: TypeAlias = "str | os.PathLike[str] | Recording | pd.DataFrame"
"""A path, a `Recording`, or a pandas frame as `Recording.from_frame` takes it."""

Some: TypeAlias = "Given | Sequence[Given]"
"""A recording, or a sequence of recordings."""


def each_of(given: Some) -> list[Given]:
    """Recordings as a list.

    Raises
    ------
    UsageError
        The list is empty.
    """
    some = list(given) if isinstance(given, list | tuple) else [given]
    if not some:
        raise UsageError("no recording is given, must be at least one")
    return some


def source_of(given: Given) -> str:
    """Path or name of a recording, for messages."""
    return os.fspath(given) if isinstance(given, str | os.PathLike) else getattr(given, "source", "frame")


def names_of(given: Given) -> list[str]:
    """Names of the channels of a recording; errors as for `recording_of`."""
    if isinstance(given, str | os.PathLike):
        return list(column_names(Path(given)))
    return list(_recording(given).channels)


def recording_of(given: Given) -> tuple[Recording, str]:
    """A recording, and the hash of its file or of its samples.

    Raises
    ------
    RecordingError
        The file cannot be read.
    UsageError
        The argument is neither a path, nor a `Recording`, nor a pandas frame.
    """
    if isinstance(given, str | os.PathLike):
        return read_recording(Path(given)), file_sha256(Path(given))
    recording = _recording(given)
    copies = {name: values.copy() for name, values in recording.channels.items()}  # frozen samples are masked later
    return Recording(recording.time_s, copies, recording.metadata, recording.source), _samples_sha256(recording)


def loaded_of(
    given: Given, input_column: str, output_column: str, on_step: OnStep, text: TextOptions | None
) -> LoadedRecording:
    """A recording made fit for identification; parameters and errors as for `intake.load_recordings`."""
    if isinstance(given, str | os.PathLike):
        return load_recordings([Path(given)], input_column, output_column, on_step, text)[0]
    recording, sha256 = recording_of(given)
    converted, notes = in_units_of(recording, [input_column, output_column])
    return usable(converted, input_column, output_column, sha256, notes)


def _recording(given: Given) -> Recording:
    if hasattr(given, "columns") and hasattr(given, "to_numpy"):
        given = Recording.from_frame(given)
    if not isinstance(given, Recording):
        raise UsageError(f"a recording is a {type(given).__name__}, must be a path, a Recording or a pandas frame")
    return given


def _samples_sha256(recording: Recording) -> str:
    digest = hashlib.sha256()
    for name, values in (("time_s", recording.time_s), *sorted(recording.channels.items())):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return digest.hexdigest()
