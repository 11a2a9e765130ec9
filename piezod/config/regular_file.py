"""Opening a file that a configuration names: a regular one of a limited size, without waiting for a writer."""

import os
import stat
from pathlib import Path
from typing import BinaryIO

from piezod.errors import ConfigurationError

_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))  # Windows has the last only


def open_regular(path: Path, most_bytes: int) -> BinaryIO:
    """Open a file for reading; a pipe, device, socket or folder, and a file that is too large, is refused unread.

    Parameters
    ----------
    most_bytes
        Largest size [byte].

    Raises
    ------
    ConfigurationError
        The file cannot be opened, is no regular file, or is too large.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
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
