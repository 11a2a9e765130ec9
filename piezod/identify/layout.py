"""How a text file is read that does not say everything itself.

It is read as the user says, else as the recordings of the model were.
"""

from dataclasses import asdict
from pathlib import Path

from piezod.errors import RecordingError
from piezod.model import Model
from piezod.model.parameters import RecordingSource, TextLayout
from piezod.recording import Recording, TextOptions, column_names


def entry_of(recording: Recording, sha256: str, text: TextOptions | None) -> RecordingSource:
    """Entry of a recording in the provenance of a model.

    Parameters
    ----------
    recording, sha256
        The recording, and the hash of its file.
    text
        What the user said about its text file; None: nothing.
    """
    told = None if text is None or text == TextOptions() else TextLayout(**asdict(text))
    return RecordingSource(path=recording.source, sha256=sha256, samples=int(recording.time_s.size), read_as=told)


def told_of(source: RecordingSource) -> TextOptions | None:
    """What the user said about a recording of the identification; None: nothing.

    Parameters
    ----------
    source
        Its entry in the model.
    """
    if source.read_as is None:
        return None
    told = source.read_as
    return TextOptions(told.columns, told.rate_Hz, told.decimal)


def layout_of(path: Path, model: Model, text: TextOptions | None) -> TextOptions | None:
    """What is known about a text file.

    Parameters
    ----------
    path
        Recording of any format.
    model
        Its recordings may have been read in a way that the user had to name.
    text
        What the user says; None: nothing.

    Returns
    -------
    TextOptions or None
        What the user says, where the file can be read so; else that of a recording of the model with which it can be.

    Raises
    ------
    RecordingError
        The file can be read in none of these ways.
    """
    try:
        column_names(path, text)
    except RecordingError:
        for told in map(told_of, model.provenance.recordings):
            if told is not None and _is_readable(path, told):
                return told
        raise
    return text


def _is_readable(path: Path, text: TextOptions) -> bool:
    try:
        column_names(path, text)
    except RecordingError:
        return False
    return True
