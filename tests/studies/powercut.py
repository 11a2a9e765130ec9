"""A file system of its own on a loop device, whose power can be cut, and a small one that can be filled.

The cut is `EXT4_IOC_SHUTDOWN` with NOLOGFLUSH: nothing that lies in memory reaches the image any more, calls fail,
and what the image holds after mounting again is what a disk would hold. The device's own cache is not part of it.
"""

import contextlib
import fcntl
import os
import shutil
import struct
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

_SHUTDOWN = 0x8004587D  # _IOR('X', 125, __u32)
_NO_LOG_FLUSH = 2


class Disk:
    """An ext4 image, mounted.

    Parameters
    ----------
    folder
        Where image and mount point lie.
    megabytes
        Its size.
    """

    def __init__(self, folder: Path, megabytes: int = 64) -> None:
        self.image, self.root = folder / "image", folder / "disk"
        self._cuts = 0
        self.root.mkdir()
        with self.image.open("wb") as file:
            file.truncate(megabytes * 1_000_000)
        _run("mkfs.ext4", "-q", "-F", self.image)
        self._mount()

    def _mount(self) -> None:
        _run("mount", "-o", "loop", self.image, self.root)

    def cut(self) -> None:
        """Cut the power."""
        descriptor = os.open(self.root, os.O_RDONLY)
        try:
            fcntl.ioctl(descriptor, _SHUTDOWN, struct.pack("I", _NO_LOG_FLUSH))
        finally:
            os.close(descriptor)

    def restore(self) -> None:
        """Mount again, as after a start of the machine; nobody may have a file open.

        What is mounted is a copy: where another mount name space still holds the disk, its image stays without power.
        """
        self.unmount()
        self._cuts += 1
        again = self.image.with_name(f"image{self._cuts}")
        _run("cp", "--sparse=always", self.image, again)
        self.image.unlink()
        self.image = again
        self._mount()

    def unmount(self) -> None:
        """Take it away; what still holds it is waited for."""
        for _ in range(50):
            done = subprocess.run(["umount", self.root], capture_output=True, text=True, check=False)
            if done.returncode == 0 or "not mounted" in done.stderr:
                return
            time.sleep(0.1)
        raise OSError(done.stderr.strip())


@contextlib.contextmanager
def disk(folder: Path, megabytes: int = 64) -> Iterator[Disk]:
    """Make a disk, and take it away whatever happens."""
    made = Disk(folder, megabytes)
    try:
        yield made
    finally:
        made.unmount()


@contextlib.contextmanager
def small_folder(folder: Path, megabytes: float) -> Iterator[Path]:
    """A file system in memory that holds so much and no more."""
    folder.mkdir()
    _run("mount", "-t", "tmpfs", "-o", f"size={round(megabytes * 1e6)}", "none", folder)
    try:
        yield folder
    finally:
        _run("umount", "-l", folder)


def fill(folder: Path) -> Path:
    """Take every byte that is left; returns the file that does."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        for size in (2**16, 2**12, 1):
            with contextlib.suppress(OSError):
                while file.write(bytes(size)):
                    pass
    return ballast


def cannot_cut() -> str:
    """Why this machine cannot cut the power of a loop device; empty when it can."""
    if os.getuid() != 0:
        return "needs root"
    if missing := [tool for tool in ("mkfs.ext4", "mount", "umount") if shutil.which(tool) is None]:
        return f"needs {', '.join(missing)}"
    if not Path("/dev/loop-control").exists():
        return "needs loop devices"
    return ""


def cannot_mount() -> str:
    """Why this machine cannot mount a small file system; empty when it can."""
    return "needs root" if os.getuid() != 0 else ""


def _run(*command: object) -> None:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
