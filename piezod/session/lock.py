"""The locks that let only one program at a time use a bench, and a device.

Two bench files may name one device, so the lock of a bench file is not enough. Each lock is a `flock` on a file.
The kernel releases it when the last process that holds it ends. No other user can open the files, so no other user can
take a lock. Programs of two users on one device are detected at the device (`control/device_guard.py`).

Only the kernel tells whether a lock is held: its holder may live in another namespace of process numbers, stand still,
or have lost the content of its file. The process number in the file serves messages. A stop opens the file of another
user as root. It passes a file that it cannot open, so a file or folder of another user blocks no stop.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from piezod.config import BenchConfig
from piezod.config.run_time_files import LOGIN, NO_SPACE, SERVICE, SHARED, own_folders
from piezod.errors import BusyError, ConfigurationError, PiezodError, TemporaryError
from piezod.runtime import clock, descriptors, processes
from piezod.session.device_names import device_names

MODE = 0o600
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
    stopping
        Whether the bench will only be brought to rest; then a file that cannot be opened is passed.

    Raises
    ------
    BusyError
        Another process holds the lock.
    ConfigurationError
        The file cannot be opened or created, or is no lock file.
    """

    def __init__(self, path: Path, wait_s: float = 0.0, *, stopping: bool = False) -> None:
        self._held: dict[Path, int] = {}
        self._own: list[Path] = []
        self._stopping = stopping
        self._acquire(path, "bench", clock.monotonic() + wait_s)

    def cover(self, devices: Iterable[str], wait_s: float = 0.0) -> None:
        """Lock devices too; locked devices stay locked.

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
        deadline_s = clock.monotonic() + wait_s
        for name in devices:
            for path in device_lock_paths(name, stopping=self._stopping):
                if path not in self._held:
                    self._acquire(path, "device", deadline_s)

    def restore(self) -> bool:
        """Make lock files again that somebody has removed; False if another program has taken one in the meantime.

        Raises
        ------
        ConfigurationError, TemporaryError
            A file cannot be made.
        """
        failed: PiezodError | None = None
        for path in self._own:
            if not _is_at(self._held[path], path):
                former = self._held[path]
                try:
                    if not path.parent.is_dir():
                        own_folders()
                    self._acquire(path, "bench", clock.monotonic())
                except BusyError:
                    return False
                except PiezodError as error:  # the other locks are tried all the same
                    failed = error
                else:
                    descriptors.close(former)
        if failed is not None:
            raise failed
        return True

    def _acquire(self, path: Path, what: str, deadline_s: float) -> None:
        descriptor = _lock(path, what, deadline_s, stopping=self._stopping)
        if descriptor is None:
            return
        self._held[path] = descriptor
        if path not in self._own:
            self._own.append(path)
        with contextlib.suppress(OSError):  # on a full file system the number is missing
            os.fchmod(descriptor, MODE)
            descriptors.truncate(descriptor, 0)
            descriptors.pwrite(descriptor, f"{processes.number()}\n".encode("ascii"), 0)

    def __reduce__(self) -> tuple[Callable[..., "BenchLock"], tuple[Any]]:
        """Pass the open files to a process that is being spawned."""
        return _inherited, ({path: processes.passed_descriptor(descriptor) for path, descriptor in self._held.items()},)

    def close(self) -> None:
        """Release the locks of this process; further calls do nothing."""
        for path, descriptor in self._held.items():
            if path in self._own and _is_at(descriptor, path):
                with contextlib.suppress(OSError):
                    path.unlink()
            descriptors.close(descriptor)
        self._held.clear()


def lock_bench(bench: BenchConfig, wait_s: float = 0.0, *, stopping: bool = False) -> BenchLock:
    """Lock a bench and its device.

    Parameters
    ----------
    wait_s
        Longest time to wait for another holder of each lock [s].
    stopping
        As in `BenchLock`.

    Raises
    ------
    BusyError
        Another process drives or watches the bench or the device.
    ConfigurationError
        A lock file cannot be opened or created, or is no lock file.
    """
    lock = BenchLock(bench.lock_path, wait_s, stopping=stopping)
    try:
        lock.cover(device_names(bench.link), wait_s)
    except BaseException:
        lock.close()
        raise
    return lock


def device_lock_paths(name: str, *, stopping: bool = False) -> list[Path]:
    """Paths of the lock files of a device, one in each folder of this user.

    Parameters
    ----------
    name
        Name of the device, from `device_names`.
    stopping
        As in `BenchLock`; then no folder is needed.

    Raises
    ------
    ConfigurationError
        No folder belongs to this user alone.
    """
    readable = re.sub(r"[^A-Za-z0-9.]+", "-", name)[:80]
    folders, user = own_folders(), os.geteuid()
    if not folders and not stopping:
        raise ConfigurationError(
            f"no folder for locks: {SERVICE} and {LOGIN / str(user)} are not of user {user}, and others have made "
            f"{SHARED}/piezod-{user} and its like; remove those"
        )
    return [folder / f"{readable}-{hashlib.sha256(name.encode()).hexdigest()[:8]}.lock" for folder in folders]


def _inherited(duplicates: dict[Path, Any]) -> BenchLock:
    lock = BenchLock.__new__(BenchLock)
    lock._held = {path: duplicate.detach() for path, duplicate in duplicates.items()}  # noqa: SLF001  # its own class
    lock._own = []  # noqa: SLF001
    lock._stopping = False  # noqa: SLF001
    return lock


def _lock(path: Path, what: str, deadline_s: float, *, stopping: bool) -> int | None:
    """Open and lock the file, trying until `deadline_s`; a file that its previous holder removed is opened again.

    None for a lock that a stop passes.
    """
    while True:
        try:
            descriptor = _open(path, any_owner=stopping and os.geteuid() == 0)
        except PiezodError:
            if stopping:
                return None
            raise
        if _locked(descriptor):
            if _is_at(descriptor, path):
                return descriptor
            descriptors.close(descriptor)
            continue
        holder = descriptors.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        descriptors.close(descriptor)
        if clock.monotonic() >= deadline_s:
            who = f"process {holder}" if holder.isdigit() else "another process"
            advice = "kill -9 makes its control process ramp down" if stopping else "stop it first"
            raise BusyError(f"{path}: {who} drives or watches this {what}; {advice}")
        clock.sleep(_RETRY_S)


def _is_at(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except OSError:
        return False


def _open(path: Path, *, any_owner: bool) -> int:
    """Open or create the file; a link, folder, pipe or device, and a file with other content, is refused."""
    flags = os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_RDWR
    try:
        with contextlib.suppress(FileExistsError):
            return descriptors.open_file(path, flags | os.O_CREAT | os.O_EXCL, MODE)
        status = path.lstat()
        if stat.S_ISREG(status.st_mode) and status.st_uid != os.geteuid() and not any_owner:
            raise BusyError(
                f"{path}: belongs to user {status.st_uid}, whose program may drive this bench; stop it, remove the file"
            )
        descriptor = descriptors.open_file(path, flags)
    except FileNotFoundError as error:
        if path.parent.is_dir():  # its holder has removed it in the meantime
            return _open(path, any_owner=any_owner)
        raise _open_error(path, error) from error
    except OSError as error:
        raise _open_error(path, error) from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        descriptors.close(descriptor)
        raise ConfigurationError(f"daemon.ring_log: {path} is not a regular file; remove it")
    if not _CONTENT.fullmatch(descriptors.pread(descriptor, 20, 0)):
        descriptors.close(descriptor)
        raise ConfigurationError(f"daemon.ring_log: {path} exists and is no lock file; name another ring log")
    return descriptor


def _locked(descriptor: int) -> bool:
    with contextlib.suppress(BlockingIOError):
        descriptors.lock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False


def _open_error(path: Path, error: OSError) -> ConfigurationError | TemporaryError:
    text = f"daemon.ring_log: {path} cannot be opened: {error.strerror}"
    if error.errno in NO_SPACE:
        return TemporaryError(f"{text}; free some space")
    return ConfigurationError(f"{text}; check its folder")
