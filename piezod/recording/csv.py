"""Recordings as CSV: `#` lines of metadata, one header row, `time_s` first, every column `name_unit`."""

import os
import warnings
from pathlib import Path
from typing import TextIO

import numpy as np

from piezod.errors import RecordingError
from piezod.recording.recording import TIME, Recording


def read_csv(path: Path) -> Recording:
    """Read a CSV recording.

    Raises
    ------
    RecordingError
        One line: the file, the row or column, and what is wrong with it.
    """
    try:
        with path.open(encoding="utf-8") as file:
            metadata, names = _read_head(file, path)
            with warnings.catch_warnings(action="ignore", category=UserWarning):  # no data: said below
                table = np.loadtxt(file, delimiter=",", comments="#", ndmin=2)
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot be read: {error}") from error
    except ValueError as error:
        raise RecordingError(f"{path}: {error}") from error
    if table.size == 0:
        raise RecordingError(f"{path}: has a header but no samples")
    if table.shape[1] != len(names):
        raise RecordingError(f"{path}: header names {len(names)} columns, the rows have {table.shape[1]}")
    columns = np.ascontiguousarray(table.T)
    return Recording(columns[0], dict(zip(names[1:], columns[1:], strict=True)), metadata, str(path))


def write_csv(recording: Recording, path: Path) -> None:
    """Write a recording, whole or not at all.

    Raises
    ------
    RecordingError
        The file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    table = np.column_stack([recording.time_s, *recording.channels.values()])
    try:
        with temporary.open("w", encoding="utf-8") as file:
            for key, value in recording.metadata.items():
                file.write(f"# {key}: {' '.join(value.split())}\n")
            file.write(",".join((TIME, *recording.channels)) + "\n")
            np.savetxt(file, table, delimiter=",", fmt=["%.9f", *["%.9g"] * len(recording.channels)])
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error


def _read_head(file: TextIO, path: Path) -> tuple[dict[str, str], list[str]]:
    """Metadata and column names; leaves the file at the first row."""
    metadata: dict[str, str] = {}
    for line in iter(file.readline, ""):
        if line.startswith("#"):
            key, _, value = line[1:].partition(":")
            metadata[key.strip()] = value.strip()
        elif line.strip():
            names = [name.strip() for name in line.split(",")]
            _check_names(names, path)
            return metadata, names
    raise RecordingError(f"{path}: is empty, must hold a header row and samples")


def _check_names(names: list[str], path: Path) -> None:
    if names[0] != TIME:
        raise RecordingError(f"{path}: first column is {names[0][:40]!r}, must be {TIME}")
    if len(set(names)) != len(names) or "" in names:
        raise RecordingError(f"{path}: column names must be unique and not empty: {', '.join(names)[:120]}")
