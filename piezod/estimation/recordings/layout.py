"""Layout of a text file that does not state it itself.

The user's options come first, then the layouts of the model's recordings.
"""

from dataclasses import asdict
from datetime import datetime
from pathlib import Path

from piezod.errors import RecordingError
from piezod.model import Model
from piezod.model.parameters import RecordingSource, TextLayout
from piezod.recording import Recording, TextOptions, column_names


def entry_of(recording: Recording, sha256: str, text: TextOptions | None) -> RecordingSource:
    """Entry of a recording in the provenance of a model; `text`: layout stated by the user, or None."""
    layout = None if text is None or text == TextOptions() else TextLayout(**asdict(text))
    return RecordingSource(
        path=recording.source,
        sha256=sha256,
        samples=int(recording.time_s.size),
        span_s=float(f"{recording.time_s[-1] - recording.time_s[0]:.6g}"),
        date=_date_of(recording),
        read_as=layout,
    )


def _date_of(recording: Recording) -> str | None:
    """Date at which a recording was complete, as `piezod record` states it; None: it states none."""
    stated = recording.metadata.get("recorded", "")
    try:
        return datetime.fromisoformat(stated).isoformat(timespec="seconds")
    except ValueError:
        return None


def stated_layout(source: RecordingSource) -> TextOptions | None:
    """Layout that the user stated when a recording was identified; None: not stated."""
    layout = source.read_as
    return None if layout is None else TextOptions(layout.columns, layout.rate_Hz, layout.decimal, layout.scale)


def layout_of(path: Path, model: Model, text: TextOptions | None) -> TextOptions | None:
    """Layout with which a file can be read; None: it needs no statement.

    Parameters
    ----------
    model
        The layouts of its recordings are tried in turn if `text` does not fit the file, those with a scale before it.
    text
        Layout stated by the user, tried first; None: not stated.

    Raises
    ------
    RecordingError
        The file cannot be read with any of the layouts.
    """
    layouts = [layout for layout in map(stated_layout, model.provenance.recordings) if layout is not None]
    for layout in layouts if text in (None, TextOptions()) else []:
        if layout.scale and _is_readable(path, layout):
            return layout
    try:
        column_names(path, text)
    except RecordingError:
        for layout in layouts:
            if _is_readable(path, layout):
                return layout
        raise
    return text


def _is_readable(path: Path, text: TextOptions) -> bool:
    try:
        column_names(path, text)
    except RecordingError:
        return False
    return True
