"""Files and folders that a command will write, checked before its work begins.

One rule for all commands: a recording, a model or a diagnosis that exists is replaced only with `--force`. Pages are
replaced without it, because they can be made again.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from piezod.errors import ConfigurationError, UsageError

RECORDING_SUFFIXES = (".csv", ".h5", ".hdf5", ".mat", ".tdms", ".parquet", ".mf4", ".sqlite", ".txt", ".xlsx")


def check_absent(target: Path, *, force: bool) -> None:
    """Refuse to replace a file.

    Parameters
    ----------
    force
        Whether the user permits it.

    Raises
    ------
    UsageError
        The file exists.
    """
    if not force and os.path.lexists(target):
        raise UsageError(f"{target} already exists; name another file, or replace it with --force")


def check_model_target(target: Path) -> None:
    """Refuse a name that later would be read as a recording.

    Parameters
    ----------
    target
        File of a model to write.

    Raises
    ------
    UsageError
        Its suffix is that of a recording.
    """
    if target.suffix.lower() in RECORDING_SUFFIXES:
        raise UsageError(f"{target}: suffix is {target.suffix!r}, a model is written as .yaml")


def check_page(target: Path | None) -> None:
    """Check that a page or another file that may be replaced can be written.

    Parameters
    ----------
    target
        File to write; None: no file.

    Raises
    ------
    ConfigurationError
        It is a folder, or its folder is missing or not writable.
    """
    if target is None:
        return
    if target.is_dir():
        raise ConfigurationError(f"{target}: cannot be written: is a folder, name a file")
    if not target.parent.is_dir() or not os.access(target.parent, os.W_OK):
        raise ConfigurationError(
            f"{target}: cannot be written: {target.parent} must be a folder that may be written to"
        )


def check_folder(folder: Path | None, names: Sequence[str] = (), *, force: bool = True) -> None:
    """Check that files can be written into a folder, which is made where it is missing.

    Parameters
    ----------
    folder
        Folder to write into; None: no folder.
    names
        Files that are not replaced.
    force
        Whether the user permits to replace them.

    Raises
    ------
    UsageError
        The folder holds one of the files.
    ConfigurationError
        It is a file, or it cannot be made or written to.
    """
    if folder is None:
        return
    existing = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if not existing.is_dir():
        raise ConfigurationError(f"{folder}: cannot be written: {existing} is a file, must be a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise ConfigurationError(f"{folder}: cannot be written: {existing} must be a folder that may be written to")
    for name in names:
        check_absent(folder / name, force=force)
