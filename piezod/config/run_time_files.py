"""Files and sockets of a running program: the folders of this user, rules for replacement, and access.

piezod replaces and removes only its own files. Mode and group are set explicitly, independent of the umask.
"""

import contextlib
import errno
import grp
import os
import socket
import stat
import sys
from pathlib import Path

from piezod.config.regular_file import open_regular
from piezod.errors import BusyError, ConfigurationError
from piezod.runtime import sockets

SERVICE = Path("/run/piezod")  # `RuntimeDirectory` of the service, made by systemd
LOGIN = Path("/run/user")  # holds the folder of each user who has logged in
SHARED = Path("/dev/shm")  # noqa: S108  # every user can make folders in it
MOST_FOLDERS = 10  # names that are tried in `SHARED`, if other users have made folders of these names
FOLDER_MODE = 0o700
FILE_MODE = 0o640  # mode of every run-time file: the owner writes, the group reads
NO_SPACE = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG, errno.EMFILE, errno.ENFILE)
"""Errors of a machine that is out of space or descriptors now, and may not be later."""


def own_folders() -> list[Path]:
    """Folders for files that no other user may make or open; those of `LOGIN` and `SHARED` are made if missing.

    A folder of another user, and a link, is not used. Two programs of a user have at least one folder in common: so a
    lock is taken in each.

    Returns
    -------
    list
        The folder of the service, of the login, and in shared memory. Empty: none can be had.
    """
    user = os.geteuid()
    numbered = [SHARED / f"piezod-{user}{f'-{number}' if number else ''}" for number in range(MOST_FOLDERS)]
    shared = next(filter(_is_own_folder, numbered), None) or next(filter(_made_folder, numbered), None)
    login = LOGIN / str(user)
    usable = [SERVICE] if _is_own_folder(SERVICE) else []
    usable += [login / "piezod"] if _is_own_folder(login) and _made_folder(login / "piezod") else []
    return usable + ([shared] if shared is not None else [])


def _is_own_folder(folder: Path) -> bool:
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o022


def _made_folder(folder: Path) -> bool:
    with contextlib.suppress(OSError):
        folder.mkdir(FOLDER_MODE)
    return _is_own_folder(folder)


def is_own_file(path: Path, key: str, magic: bytes, head_bytes: int = 0) -> bool:
    """Whether piezod made the file at `path`; False if there is none.

    Parameters
    ----------
    key
        Key of the bench file, for the message.
    magic
        First bytes of every file that piezod makes for this key.
    head_bytes
        Length of the head in which `magic` stands; 0: at its begin.

    Raises
    ------
    ConfigurationError
        Something else is there.
    """
    try:
        status = path.lstat()
    except FileNotFoundError:
        return False
    except OSError as error:
        raise ConfigurationError(f"{key}: {path} cannot be used: {error.strerror}") from error
    reason = _strange(status) or _without_magic(path, magic, head_bytes)
    if reason:
        raise ConfigurationError(f"{key}: {path} {reason}; piezod replaces only its own files: name another path")
    return True


def _strange(status: os.stat_result) -> str:
    """Reason why a file is not the caller's regular file; empty: it is."""
    if not stat.S_ISREG(status.st_mode):
        return "is not a regular file"
    return "" if is_owner(status) else f"belongs to user {status.st_uid}"


def is_owner(status: os.stat_result) -> bool:
    """Whether this process may regard a file as its own: it owns it, or it is root."""
    return os.geteuid() in (0, status.st_uid)


def _without_magic(path: Path, magic: bytes, head_bytes: int) -> str:
    """Reason why a file was not made by piezod; an empty file, for example a truncated one, may be replaced."""
    try:
        with open_regular(path, sys.maxsize) as file:
            head = file.read(head_bytes or len(magic))
            return "" if magic in head or not head else "exists, and was not made by piezod"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    except ConfigurationError as error:
        return str(error).removeprefix(f"{path}: ")


def group_id(group: str | None, key: str) -> int:
    """Number of a group; the group of this process for None.

    Parameters
    ----------
    key
        Key of the bench file, for the message.

    Raises
    ------
    ConfigurationError
        The group does not exist.
    """
    if group is None:
        return os.getegid()
    try:
        return grp.getgrnam(group).gr_gid
    except KeyError:
        raise ConfigurationError(f"{key} is '{group}', which does not exist; create it or name another") from None


def set_access(target: int | Path, mode: int, gid: int) -> None:
    """Set mode and group of a file or socket.

    Parameters
    ----------
    target
        Open file, or path of a socket.
    mode
        Permission bits.

    Raises
    ------
    OSError
        This process must not give the file to this group.
    """
    if os.stat(target).st_gid != gid:  # noqa: PTH116  # also for an open file; the sandbox of the service forbids chown
        os.chown(target, -1, gid)
    os.chmod(target, mode)  # noqa: PTH101


class UnixSocket:
    """A bound unix socket; its file is removed on close unless it was replaced.

    Parameters
    ----------
    kind
        `socket.SOCK_STREAM` or `socket.SOCK_DGRAM`.
    key
        Key of the bench file, for messages; its section has the key `socket_group`.
    mode
        Permission bits, octal digits.
    group
        Name of a group; None: the group of this process.

    Attributes
    ----------
    socket
        The bound socket, non-blocking.

    Raises
    ------
    BusyError
        Another process listens there.
    ConfigurationError
        Something else than an abandoned socket is there, the path cannot be bound, or the group does not exist.
    """

    def __init__(self, kind: socket.SocketKind, path: Path, key: str, mode: str, group: str | None) -> None:
        gid = group_id(group, f"{key.partition('.')[0]}.socket_group")
        self._path = path
        self._identity: tuple[int, int] | None = None
        self.socket = sockets.socket(socket.AF_UNIX, kind | socket.SOCK_CLOEXEC)
        try:
            _remove_abandoned(path, key)
            before = os.umask(0o777)  # no connection before group and mode are set
            try:
                self.socket.bind(str(path))
            finally:
                os.umask(before)
            self._identity = _identity(path)
            set_access(path, int(mode, 8), gid)
            self.socket.setblocking(False)
        except OSError as error:
            self.close()
            raise ConfigurationError(f"{key}: {path} cannot be bound: {error.strerror or error}") from error
        except BaseException:
            self.close()
            raise

    @property
    def is_present(self) -> bool:
        """Whether the file of this socket still stands at its path."""
        try:
            return _identity(self._path) == self._identity
        except OSError:
            return False

    def close(self) -> None:
        """Close the socket and remove its file; further calls do nothing."""
        self.socket.close()
        with contextlib.suppress(OSError):
            if self._identity is not None and _identity(self._path) == self._identity:
                self._path.unlink()
        self._identity = None


def _identity(path: Path) -> tuple[int, int]:
    status = path.lstat()
    return status.st_dev, status.st_ino


def _remove_abandoned(path: Path, key: str) -> None:
    """Remove an own socket without a listener; refuse everything else."""
    try:
        status = path.lstat()
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(status.st_mode):
        raise ConfigurationError(
            f"{key}: {path} exists and is no socket; piezod replaces only its own sockets: name another path"
        )
    with sockets.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(str(path))
        except (ConnectionRefusedError, FileNotFoundError):
            pass
        except PermissionError as error:
            raise ConfigurationError(f"{key}: {path} belongs to another user; name another path") from error
        except OSError:  # of another type, or full: somebody listens
            raise _in_use(path, key) from None
        else:
            raise _in_use(path, key)
    if not is_owner(status):
        raise ConfigurationError(f"{key}: {path} belongs to user {status.st_uid}; name another path")
    path.unlink(missing_ok=True)


def _in_use(path: Path, key: str) -> BusyError:
    return BusyError(f"{key}: {path}: another daemon listens there; stop it, or name another path")
