"""The locks that let only one program at a time use a bench, and a device.

Two bench files may name the same device, so the lock of a bench file is not enough. Each lock is a `flock` on a file.
The kernel releases it when the last process that holds it ends.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import stat
import time
from collections.abc import Callable, Iterable
from multiprocessing import reduction
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig
from piezod.config.run_time_files import FILE_MODE, NO_SPACE
from piezod.errors import BusyError, ConfigurationError, TemporaryError
from piezod.session.device_names import device_names

DEVICE_LOCKS = Path("/dev/shm")  # noqa: S108  # the same folder for every user and every bench file
DEVICE_MODE = 0o644
"""Mode of the lock file of a device: another user can open it to wait for the lock, and not change it."""
_RETRY_S = 0.05
_CONTENT = re.compile(rb"[0-9]{0,10}\n?")  # process number of the holder


class BenchLock:
    """The locks of one bench and of its device.

    A process that is spawned with this object as an argument holds the locks too. The locks of a control process
    therefore stay when its parent is killed.

    Parameters
    ----------
    path
        Lock file of the bench; `close` of the process that created the object removes it.
    wait_s
        Longest time to wait for another holder [s].

    Raises
    ------
    BusyError
        Another process holds the lock.
    ConfigurationError
        The file cannot be opened or created, or is no lock file.
    """

    def __init__(self, path: Path, wait_s: float = 0.0) -> None:
        self._held: dict[Path, int] = {}
        self._own: list[Path] = []
        self._take(path, FILE_MODE, "bench", time.monotonic() + wait_s)

    def cover(self, devices: Iterable[str], wait_s: float = 0.0) -> None:
        """Lock devices too; those that are locked already stay locked.

        Parameters
        ----------
        devices
            Names of the device, from `device_names`.
        wait_s
            Longest time to wait for another holder [s].

        Raises
        ------
        BusyError
            Another process drives or watches the device.
        """
        deadline_s = time.monotonic() + wait_s
        for name in devices:
            path = device_lock_path(name)
            if path not in self._held:
                self._take(path, DEVICE_MODE, "device", deadline_s)

    def _take(self, path: Path, mode: int, what: str, deadline_s: float) -> None:
        self._held[path] = descriptor = _lock(path, mode, what, deadline_s)
        self._own.append(path)
        with contextlib.suppress(
            OSError
        ):  # on a full file system, or in the file of another user, the number is missing
            os.fchmod(descriptor, mode)
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"{os.getpid()}\n".encode("ascii"), 0)

    def __reduce__(self) -> tuple[Callable[..., "BenchLock"], tuple[Any]]:
        """Pass the open files to a process that is being spawned."""
        return _inherited, ({path: reduction.DupFd(descriptor) for path, descriptor in self._held.items()},)

    def close(self) -> None:
        """Release the locks of this process; further calls do nothing."""
        for path, descriptor in self._held.items():
            if path in self._own and _is_at(descriptor, path):
                with contextlib.suppress(OSError):
                    path.unlink()
            os.close(descriptor)
        self._held.clear()


def lock_bench(bench: BenchConfig, wait_s: float = 0.0) -> BenchLock:
    """Lock a bench and its device.

    Parameters
    ----------
    bench
        Bench configuration.
    wait_s
        Longest time to wait for another holder of each lock [s].

    Raises
    ------
    BusyError
        Another process drives or watches the bench or the device.
    ConfigurationError
        A lock file cannot be opened or created, or is no lock file.
    """
    lock = BenchLock(bench.lock_path, wait_s)
    try:
        lock.cover(device_names(bench.link), wait_s)
    except BaseException:
        lock.close()
        raise
    return lock


def device_lock_path(name: str) -> Path:
    """Path of the lock file of a device.

    Parameters
    ----------
    name
        Name of the device, from `device_names`.
    """
    readable = re.sub(r"[^A-Za-z0-9.]+", "-", name)[:80]
    return DEVICE_LOCKS / f"piezod-{readable}-{hashlib.sha256(name.encode()).hexdigest()[:8]}.lock"


def _inherited(duplicates: dict[Path, Any]) -> BenchLock:
    lock = BenchLock.__new__(BenchLock)
    lock._held = {path: duplicate.detach() for path, duplicate in duplicates.items()}  # noqa: SLF001  # its own class
    lock._own = []  # noqa: SLF001
    return lock


def _lock(path: Path, mode: int, what: str, deadline_s: float) -> int:
    """Open and lock the file, trying until `deadline_s`; a file that its previous holder removed is opened again."""
    while True:
        descriptor = _open(path, mode)
        if _locked(descriptor):
            if _is_at(descriptor, path):
                return descriptor
            os.close(descriptor)
            continue
        holder = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        if time.monotonic() >= deadline_s:
            who = f"process {holder}" if holder.isdigit() else "another process"
            raise BusyError(f"{path}: {who} drives or watches this {what}; stop it first")
        time.sleep(_RETRY_S)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False


def _open(path: Path, mode: int) -> int:
    """Open or create the file; a link, folder, pipe or device, and a file with other content, is refused."""
    flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        with contextlib.suppress(FileExistsError):
            return os.open(path, flags | os.O_RDWR | os.O_CREAT | os.O_EXCL, mode)
        try:
            descriptor = os.open(path, flags | os.O_RDWR)
        except PermissionError:  # the file of another user
            descriptor = os.open(path, flags | os.O_RDONLY)
    except FileNotFoundError as error:
        if path.parent.is_dir():  # its holder has removed it in the meantime
            return _open(path, mode)
        raise _open_error(path, error) from error
    except OSError as error:
        raise _open_error(path, error) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise ConfigurationError(f"daemon.ring_log: {path} is not a regular file; remove it")
    if not _CONTENT.fullmatch(os.pread(descriptor, 20, 0)):
        os.close(descriptor)
        raise ConfigurationError(f"daemon.ring_log: {path} exists and is no lock file; name another ring log")
    return descriptor


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _open_error(path: Path, error: OSError) -> ConfigurationError | TemporaryError:
    text = f"daemon.ring_log: {path} cannot be opened: {error.strerror}"
    if error.errno in NO_SPACE:
        return TemporaryError(f"{text}; free some space")
    return ConfigurationError(f"{text}; check its folder")


__all__ = ["BenchLock", "device_lock_path", "lock_bench"]
