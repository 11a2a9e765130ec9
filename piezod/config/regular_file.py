"""Opening a file that a configuration names: a regular one of a limited size, without waiting for a writer."""

import difflib
import os
import stat
from io import BufferedReader
from pathlib import Path

from piezod.errors import ConfigurationError

CLOSE = 0.6  # similarity of names above which one may be meant: difflib's default
HEAD_BYTES = 4096  # in which a file of piezod states its schema
_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))  # Windows has the last only


def open_regular(path: Path, most_bytes: int, schema: bytes = b"") -> BufferedReader:
    """Open a file for reading; a pipe, device, socket or folder, and a file that is too large, is refused unread.

    Parameters
    ----------
    most_bytes
        Largest size [byte].
    schema
        Text near the begin of such files; the message for a missing file names a similar file of its folder.

    Raises
    ------
    ConfigurationError
        The file cannot be opened, is no regular file, or is too large.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    except OSError as error:
        meant = _meant(path, schema) if isinstance(error, FileNotFoundError) else ""
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}{meant}") from error
    except ValueError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}; no file has such a name") from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode) or status.st_size > most_bytes:
        os.close(descriptor)
        if stat.S_ISDIR(status.st_mode):
            raise ConfigurationError(f"{path}: cannot be read: Is a directory")
        if not stat.S_ISREG(status.st_mode):
            raise ConfigurationError(f"{path}: is a pipe, socket or device, must be a regular file")
        raise ConfigurationError(f"{path}: has {status.st_size} bytes, must have at most {most_bytes}")
    return os.fdopen(descriptor, "rb")


def _meant(path: Path, schema: bytes) -> str:
    """Question after a file of a similar name in the folder of a missing file; empty: no such file."""
    try:
        beside = [one for one in sorted(path.parent.iterdir()) if one.suffix == path.suffix and one.is_file()]
    except (OSError, ValueError):
        return ""
    names = [one.name for one in beside if _has(one, schema)]
    close = difflib.get_close_matches(path.name, names, n=1, cutoff=CLOSE) or (
        names if len(names) == 1 and schema else []
    )
    return f"; did you mean '{close[0]}'?" if close else ""


def _has(path: Path, schema: bytes) -> bool:
    """Whether a text stands near the begin of a file."""
    try:
        with path.open("rb") as file:
            return schema in file.read(HEAD_BYTES)
    except OSError:
        return False
