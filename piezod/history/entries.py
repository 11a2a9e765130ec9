"""Models in files and folders, each once, ordered by lineage and date."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from piezod.errors import ConfigurationError
from piezod.model import Model, dump_model, file_sha256, load_model

HEAD = 4096  # bytes in which a model file states its schema
SCHEMA = b"piezod.model/"
SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True)
class ModelEntry:
    """A model with its files.

    Parameters
    ----------
    paths
        Files that hold this model, at least one.
    hashes
        SHA-256 of these files; a child names its parent by such a hash.
    """

    model: Model
    paths: tuple[Path, ...]
    hashes: frozenset[str]

    @property
    def date(self) -> datetime:
        """Date of the newest recording with a part in the model, if any states one; else the date of the model."""
        provenance = self.model.provenance
        stated = [entry.date for entry in (*provenance.recordings, *provenance.diagnosed) if entry.date]
        return max(map(_parsed, stated), default=_parsed(provenance.created))

    @property
    def parent(self) -> str | None:
        """SHA-256 of the parent's file; None: identified, or of an older version."""
        return self.model.provenance.parent


def find_models(paths: Sequence[Path]) -> list[ModelEntry]:
    """Models in files and folders, a parent before its children, else by date.

    Parameters
    ----------
    paths
        Model files, and folders. Of a folder, the model files in it and in its subfolders are read, one level deep.

    Raises
    ------
    ConfigurationError, ModelError
        A file is no model or a broken one, or a folder holds no model.
    """
    entries: dict[str, ModelEntry] = {}
    for path in dict.fromkeys(file for place in paths for file in _model_files(place)):
        model, sha256 = load_model(path), file_sha256(path)
        text = hashlib.sha256(dump_model(model).encode()).hexdigest()
        known = entries.get(text)
        if known is None:
            entries[text] = ModelEntry(model, (path,), frozenset((sha256,)))
        else:
            entries[text] = replace(known, paths=(*known.paths, path), hashes=known.hashes | {sha256})
    return in_order(list(entries.values()))


def in_order(entries: Sequence[ModelEntry]) -> list[ModelEntry]:
    """Entries by date, but each parent before its children."""
    ordered: list[ModelEntry] = []

    def add(entry: ModelEntry) -> None:
        if any(known is entry for known in ordered):
            return
        parent = parent_of(entry, entries)
        if parent is not None:
            add(parent)
        ordered.append(entry)

    for entry in sorted(entries, key=lambda entry: entry.date):
        add(entry)
    return ordered


def parent_of(entry: ModelEntry, entries: Sequence[ModelEntry]) -> ModelEntry | None:
    """Entry with the parent of a model; None where it is not among the entries."""
    return next((other for other in entries if entry.parent in other.hashes), None)


def _model_files(path: Path) -> list[Path]:
    """The file itself, or the model files of a folder."""
    if not path.is_dir():
        return [path]
    files = [file for place in (path, *sorted(path.iterdir())) if place.is_dir() for file in sorted(place.iterdir())]
    models = [file for file in files if file.suffix in SUFFIXES and file.is_file() and _states_schema(file)]
    if not models:
        raise ConfigurationError(f"{path}: holds no model file, nor do its subfolders; name a file or another folder")
    return models


def _states_schema(file: Path) -> bool:
    try:
        with file.open("rb") as content:
            return SCHEMA in content.read(HEAD)
    except OSError as error:
        raise ConfigurationError(f"{file}: cannot be read: {error.strerror}") from error


def _parsed(text: str) -> datetime:
    """Date in UTC; the begin of 1970 where the text is no date."""
    try:
        date = datetime.fromisoformat(text)
    except ValueError:
        return datetime.fromtimestamp(0, UTC)
    return date.replace(tzinfo=UTC) if date.tzinfo is None else date.astimezone(UTC)
