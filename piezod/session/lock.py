"""The lock that lets only one program at a time use a bench.

It is a `flock` on a file. The kernel releases it when the last process that holds it ends.
"""

import contextlib
import fcntl
import os
import stat
import time
from collections.abc import Callable
from multiprocessing import reduction
from pathlib import Path
from typing import Any

from piezod.errors import BusyError, ConfigurationError

_RETRY_S = 0.05


class BenchLock:
    """The lock of one bench.

    A process that is spawned with this object as an argument holds the lock too. The lock of a control process
    therefore stays when its parent is killed.

    Parameters
    ----------
    path
        Lock file; `close` of the process that created the object removes it.
    wait_s
        Longest time to wait for another holder [s].

    Raises
    ------
    BusyError
        Another process holds the lock.
    ConfigurationError
        The file cannot be opened or created.
    """

    def __init__(self, path: Path, wait_s: float = 0.0) -> None:
        self._path: Path | None = path
        self._descriptor = _lock(path, time.monotonic() + wait_s)
        os.ftruncate(self._descriptor, 0)
        os.pwrite(self._descriptor, f"{os.getpid()}\n".encode("ascii"), 0)

    def __reduce__(self) -> tuple[Callable[..., "BenchLock"], tuple[Any]]:
        """Pass the open file to a process that is being spawned."""
        return _inherited, (reduction.DupFd(self._descriptor),)

    def close(self) -> None:
        """Release the lock of this process; further calls do nothing."""
        if self._descriptor >= 0 and self._path is not None:
            self._path.unlink(missing_ok=True)
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def _inherited(duplicate: Any) -> BenchLock:  # noqa: ANN401  # multiprocessing has no public type for it
    lock = BenchLock.__new__(BenchLock)
    lock._path, lock._descriptor = None, duplicate.detach()  # noqa: SLF001  # its own class
    return lock


def _lock(path: Path, deadline_s: float) -> int:
    """Open and lock the file, trying until `deadline_s`; a file that its previous holder removed is opened again."""
    while True:
        descriptor = _open(path)
        if _locked(descriptor):
            if _is_at(descriptor, path):
                return descriptor
            os.close(descriptor)
            continue
        holder = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        if time.monotonic() >= deadline_s:
            who = f"process {holder}" if holder.isdigit() else "another process"
            raise BusyError(f"{path}: {who} drives or watches this bench; stop it first")
        time.sleep(_RETRY_S)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False


def _open(path: Path) -> int:
    """Open or create the file; a link, folder, pipe or device is refused."""
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        with contextlib.suppress(FileExistsError):
            return os.open(path, flags | os.O_CREAT | os.O_EXCL, 0o640)
        descriptor = os.open(path, flags)
    except OSError as error:
        raise ConfigurationError(
            f"daemon.ring_log: {path} cannot be opened: {error.strerror}; check its folder"
        ) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise ConfigurationError(f"daemon.ring_log: {path} is not a regular file; remove it")
    return descriptor


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
