"""Access to files and libraries, shared by all formats: optional imports, one-line errors, replacement as a whole."""

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from piezod.config.regular_file import open_regular
from piezod.errors import ConfigurationError, RecordingError
from piezod.runtime.files import replaced

MOST_ERROR_TEXT = 200  # characters of a library's error text that a message quotes


def import_library(module: str, extra: str, path: Path) -> Any:  # noqa: ANN401  a module without type information
    """Import the library of a format when a file of this format is opened, not before: the daemon never loads it.

    Parameters
    ----------
    module
        Name of the module, such as `pyarrow.parquet`.
    extra
        Name of the optional dependency group of piezod that installs it.
    path
        File that needs it, for the message.

    Raises
    ------
    RecordingError
        The library is not installed; the message names the package to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise RecordingError(f"{path}: needs {package}; pip install 'piezod-bench[{extra}]'") from error


def open_file(path: Path, most_bytes: int = sys.maxsize) -> BinaryIO:
    """Open a regular file for reading. A fifo or a device is refused: it may never return.

    Parameters
    ----------
    most_bytes
        Largest size [byte].

    Raises
    ------
    RecordingError
        The file cannot be opened, is no regular file, or is too large.
    """
    try:
        return open_regular(path, most_bytes)
    except ConfigurationError as error:
        raise RecordingError(str(error)) from error


@contextmanager
def library_errors(path: Path, action: str) -> Iterator[None]:
    """Turn any error of a file library into a RecordingError of one line that names the file.

    Parameters
    ----------
    action
        Past participle for the message: `read` or `written`.
    """
    try:
        yield
    except RecordingError:
        raise
    except Exception as error:  # on damaged files the libraries raise anything: struct.error, KeyError, ...
        text = (error.strerror or str(error)) if isinstance(error, OSError) else str(error)
        text = " ".join(text.split())[:MOST_ERROR_TEXT] or type(error).__name__
        raise RecordingError(f"{path}: cannot be {action}: {text}") from error


@contextmanager
def replaced_file(path: Path) -> Iterator[Path]:
    """Temporary file in the folder of `path`: replaces `path` after success, is deleted after an error.

    Parameters
    ----------
    path
        File to replace; its folder exists.
    """
    with library_errors(path, "written"), replaced(path) as temporary:
        yield temporary
