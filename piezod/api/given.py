"""What a caller may give for a recording: a file, a `Recording`, or a pandas frame."""

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from piezod.errors import UsageError
from piezod.model import file_sha256
from piezod.recording import Recording, TextOptions, read_recording
from piezod.recording.conversion import choose_columns, in_units_of

Given = str | os.PathLike[str] | Recording | Any
"""A path, a `Recording`, or a pandas frame as `Recording.from_frame` takes it."""

Some = Given | Sequence[Given]
"""One or several of them."""


def each_of(given: Some) -> list[Given]:
    """One or several recordings as a list.

    Raises
    ------
    UsageError
        There is none.
    """
    some = list(given) if isinstance(given, list | tuple) else [given]
    if not some:
        raise UsageError("no recording is given, must be at least one")
    return some


def recording_of(given: Given, text: TextOptions | None = None) -> tuple[Recording, str]:
    """A recording, and the hash of its file or of its samples.

    Parameters
    ----------
    given
        A path, a `Recording`, or a pandas frame.
    text
        What the caller says about a text file.

    Raises
    ------
    RecordingError
        The file cannot be read.
    UsageError
        It is none of these.
    """
    if isinstance(given, str | os.PathLike):
        path = Path(given)
        return read_recording(path, text), file_sha256(path)
    if hasattr(given, "columns") and hasattr(given, "to_numpy"):
        given = Recording.from_frame(given)
    if not isinstance(given, Recording):
        raise UsageError(f"a recording is a {type(given).__name__}, must be a path, a Recording or a pandas frame")
    own = {name: values.copy() for name, values in given.channels.items()}  # what is frozen or clipped is masked
    return Recording(given.time_s, own, given.metadata, given.source), _samples_sha256(given)


def with_columns(
    recording: Recording, input_column: str | None, output_column: str | None
) -> tuple[Recording, str, str, list[str]]:
    """A recording with input and output in the units of their names, both names, and notes.

    Raises
    ------
    RecordingError
        The names of its channels do not tell which are meant.
    """
    names = {"input": input_column, "output": output_column}
    input_name, output_name, chosen = choose_columns(Path(recording.source), list(recording.channels), names)
    converted, notes = in_units_of(recording, [input_name, output_name])
    return converted, input_name, output_name, chosen + notes


def _samples_sha256(recording: Recording) -> str:
    digest = hashlib.sha256()
    for name, values in (("time_s", recording.time_s), *sorted(recording.channels.items())):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(values, dtype=np.float64).tobytes())
    return digest.hexdigest()
