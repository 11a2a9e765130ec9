"""An archive: a folder for each bench, with `model.yaml`, the model of the bench, and its recordings."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from piezod.errors import ConfigurationError, PiezodError, UsageError
from piezod.model import Model, file_sha256, load_model
from piezod.recording import column_names
from piezod.recording.files import FORMATS, READ_ONLY, SPREADSHEETS

MODEL = "model.yaml"
FINDINGS = "findings.json"  # a folder with it is the output of a diagnosis, not a bench
SUFFIXES = frozenset((*FORMATS, *READ_ONLY, *SPREADSHEETS))
HEAD = 8192  # bytes in which a text file states its date
STATED_DATE = re.compile(rb"^#\s*recorded:\s*(\S+)\s*$", re.MULTILINE)
MARK = "archive.json"  # file that marks a folder with diagnoses of an archive


@dataclass(frozen=True)
class ArchivedRecording:
    """A recording in an archive; `date`: as `piezod record` states it in the file, or None."""

    path: Path
    sha256: str
    date: datetime | None


@dataclass(frozen=True)
class Bench:
    """A bench of an archive.

    Parameters
    ----------
    model_path
        Its model before the first recording.
    recordings
        Its recordings in order of time, without the identification recordings of the model. The dates give the order
        if all recordings state one, else the names, in which numbers count as numbers.
    """

    name: str
    model_path: Path
    model: Model
    recordings: tuple[ArchivedRecording, ...]


def is_archive(path: Path) -> bool:
    """Whether a folder has at least one subfolder with a model and a recording for it."""
    return path.is_dir() and any(_holds_recording(folder) for folder in _bench_folders(path))


def find_benches(archives: Sequence[Path]) -> list[Bench]:
    """Benches of archives, by name.

    Raises
    ------
    ConfigurationError, ModelError
        The model of a bench is broken, or an archive holds no bench.
    UsageError
        Two benches have one name.
    """
    benches: dict[str, Bench] = {}
    for archive in archives:
        folders = _bench_folders(archive) if archive.is_dir() else []
        if not folders:
            raise ConfigurationError(f"{archive}: holds no folder with {MODEL} and recordings of a bench")
        for folder in folders:
            if folder.name in benches:
                raise UsageError(f"{folder} and {benches[folder.name].model_path.parent}: two benches have one name")
            benches[folder.name] = _bench(folder)
    return [benches[name] for name in sorted(benches, key=in_numbers)]


def in_numbers(name: str) -> list[tuple[int, str]]:
    """Key of a name for sorting: week 9 comes before week 10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def _bench_folders(archive: Path) -> list[Path]:
    """Subfolders with a model and files with the suffix of a recording."""
    return [
        folder
        for folder in sorted(archive.iterdir())
        if folder.is_dir()
        and (folder / MODEL).is_file()
        and not any((folder / name).exists() for name in (FINDINGS, MARK))
        and _recording_files(folder)
    ]


def _recording_files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.iterdir()) if path.suffix.lower() in SUFFIXES and path.is_file()]


def _holds_recording(folder: Path) -> bool:
    """Whether a file in a folder has the columns of the model there."""
    try:
        model = load_model(folder / MODEL)
    except PiezodError:
        return False
    wanted = {channel.channel.removeprefix("-") for channel in (model.input, model.output)}
    for path in _recording_files(folder):
        try:
            if wanted <= set(column_names(path)):
                return True
        except PiezodError:
            continue
    return False


def _bench(folder: Path) -> Bench:
    model = load_model(folder / MODEL)
    known = {entry.sha256 for entry in (*model.provenance.recordings, *model.provenance.diagnosed)}
    files = [(path, file_sha256(path)) for path in _recording_files(folder)]
    recordings = [ArchivedRecording(path, sha256, _date_of(path)) for path, sha256 in files if sha256 not in known]
    recordings.sort(key=lambda recording: in_numbers(recording.path.name))
    dates = {recording.path: recording.date for recording in recordings if recording.date is not None}
    if len(dates) == len(recordings):
        recordings.sort(key=lambda recording: dates[recording.path])
    return Bench(folder.name, folder / MODEL, model, tuple(recordings))


def _date_of(path: Path) -> datetime | None:
    """Date that the head of a text file states, in UTC; None: it states none."""
    try:
        with path.open("rb") as file:
            stated = STATED_DATE.search(file.read(HEAD))
        date = datetime.fromisoformat(stated[1].decode()) if stated else None
    except (OSError, ValueError):
        return None
    if date is None:
        return None
    return date.replace(tzinfo=UTC) if date.tzinfo is None else date.astimezone(UTC)
