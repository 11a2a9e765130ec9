"""Recordings of a diagnosis as they are read: the diagnosed recordings, and the identification recordings."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from piezod.estimation.recordings.intake import file_notes
from piezod.estimation.recordings.layout import stated_layout
from piezod.estimation.recordings.series import Role
from piezod.model import Model, file_sha256
from piezod.recording import Recording, TextOptions, read_recording
from piezod.recording.conversion import in_units_of


@dataclass(frozen=True)
class Source:
    """Recording as read."""

    recording: Recording
    sha256: str
    role: Role  # whether it is diagnosed or was used for the identification
    condition: str | None = None  # COLUMN=VALUE at which its readings count; None: everywhere
    notes: tuple[str, ...] = ()  # remarks about the file format and converted channels
    text: TextOptions | None = None  # options for a text file; None: defaults

    @property
    def name(self) -> str:
        """Name of the file."""
        return Path(self.recording.source).name or self.recording.source


def read_source(
    path: Path, role: Role, columns: Sequence[str], condition: str | None = None, text: TextOptions | None = None
) -> Source:
    """Read a recording.

    `columns`: required channels; a channel in another multiple of its unit is converted. Others as in `Source`.

    Raises
    ------
    RecordingError
        The file cannot be read.
    """
    recording, converted = in_units_of(read_recording(path, text), columns)
    notes = tuple(f"{path}: {note}" for note in file_notes(recording.metadata, converted))
    return Source(recording, file_sha256(path), role, condition, notes, text)


def past_sources(model: Model, folder: Path, diagnosed: Sequence[Source]) -> tuple[list[Source], list[str]]:
    """Identification recordings of a model that still exist unchanged, and a note about each other one.

    `folder`: folder of the model file, where relative paths are looked up too. Diagnosed recordings are not used again.
    """
    sources, notes = [], []
    hashes = {source.sha256 for source in diagnosed}
    for entry in model.provenance.recordings:
        places = (Path(entry.path), folder / entry.path, folder / Path(entry.path).name)
        path = next((place for place in places if place.is_file() and file_sha256(place) == entry.sha256), None)
        if entry.sha256 in hashes:
            continue
        if path is None:
            notes.append(f"{entry.path}, which the model was identified on, is not there or not the same any more")
        else:
            columns = (model.input.channel, model.output.channel)
            sources.append(read_source(path, "identification", columns, text=stated_layout(entry)))
    return sources, notes
