"""Write a file whole or not at all; all rooms use this module.

    written(path, text)              a text or bytes
    with replaced(path) as part:     a library writes `part`, which then takes the place of `path`
    written_folder(path, files)      a folder with these files

The part has a random name, is created by this call and follows no link. Its content and the folder are
on the disk before the caller goes on. The mode of a file that is replaced stays. A link is replaced, not followed.
"""

import os
import secrets
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from piezod.errors import ConfigurationError

_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
_LONGEST_NAME = 200  # of the part of a name that a temporary name keeps, its end with the suffix [character]


@contextmanager
def replaced(path: Path, *, mode: int | None = None, force: bool = True) -> Iterator[Path]:
    """Temporary file in the folder of `path`: takes its place after success, is deleted after an error.

    Parameters
    ----------
    path
        File to replace; its folder exists.
    mode
        Mode of the new file; None: the mode of the replaced file, or as usual for a new file.
    force
        Whether an existing file is replaced.

    Raises
    ------
    FileExistsError
        The file exists, and `force` is not set.
    OSError
        The file cannot be written, or the path names a folder, pipe, socket or device.
    """
    mode = _mode_of(path) if mode is None else mode
    part = path.with_name(f".{secrets.token_hex(8)}.{path.name[-_LONGEST_NAME:]}")
    os.close(os.open(part, _NEW, 0o666 if mode is None else 0o600))
    try:
        yield part
        _finish(part, path, mode, force=force)
    finally:
        part.unlink(missing_ok=True)


def _finish(part: Path, path: Path, mode: int | None, *, force: bool) -> None:
    if mode is not None:
        part.chmod(mode)
    _sync(part, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    if force:
        part.replace(path)
    else:
        os.link(part, path)  # fails if the file exists, also if it was created a moment ago
    if hasattr(os, "O_DIRECTORY"):
        with suppress(PermissionError):  # a folder in which files may be made but not listed
            _sync(path.parent, os.O_RDONLY | os.O_DIRECTORY)


def written(
    path: Path, content: str | bytes, *, mode: int | None = None, force: bool = True, parents: bool = False
) -> None:
    """Write a file; an error leaves an existing file as it was.

    Parameters
    ----------
    path, mode, force
        As for `replaced`.
    content
        New content; a text is written in UTF-8.
    parents
        Whether a missing folder is made.

    Raises
    ------
    FileExistsError
        The file exists, and `force` is not set.
    ConfigurationError
        The file cannot be written.
    """
    try:
        if parents:
            path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(path, mode=mode, force=force) as part:
            part.write_bytes(content.encode() if isinstance(content, str) else content)
    except FileExistsError:
        if force:
            raise ConfigurationError(f"{path}: cannot be written: {path.parent} is no folder") from None
        raise
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error


def written_folder(path: Path, files: Mapping[str, bytes]) -> None:
    """Write a folder that replaces the old one, complete or not at all; a missing folder above it is made.

    Parameters
    ----------
    path
        Folder to replace.
    files
        File name to content.

    Raises
    ------
    ConfigurationError
        The folder cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as temporary:
            part = Path(temporary) / path.name
            part.mkdir()
            for name, content in files.items():
                (part / name).write_bytes(content)
            shutil.rmtree(path, ignore_errors=True)
            part.rename(path)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror}") from error


def _mode_of(path: Path) -> int | None:
    """Mode of the regular file that is replaced; None: there is none.

    A folder, and a pipe, socket or device, also behind a link, is never replaced.
    """
    try:
        status, target = path.lstat(), path.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(target.st_mode):
        raise IsADirectoryError(21, "Is a directory")
    if not stat.S_ISREG(target.st_mode):
        raise OSError(22, "is a pipe, socket or device, must be a regular file")
    return stat.S_IMODE(status.st_mode) if stat.S_ISREG(status.st_mode) else None


def _sync(path: Path, flags: int) -> None:
    descriptor = os.open(path, flags | getattr(os, "O_CLOEXEC", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
