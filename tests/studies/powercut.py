"""A file system on a loop device with a simulated power cut, and a small file system to fill.

The cut is `EXT4_IOC_SHUTDOWN` with NOLOGFLUSH: no data in memory reaches the image any more, and calls fail. The image
then holds what a disk would hold; the cache of a real device is not simulated.
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
    """A mounted ext4 image.

    Parameters
    ----------
    folder
        Folder of image and mount point.
    megabytes
        Size of the image [MB].
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
        """Simulate the power cut."""
        descriptor = os.open(self.root, os.O_RDONLY)
        try:
            fcntl.ioctl(descriptor, _SHUTDOWN, struct.pack("I", _NO_LOG_FLUSH))
        finally:
            os.close(descriptor)

    def restore(self) -> None:
        """Mount again, as after a restart of the machine; no file may be open.

        A copy is mounted, since another mount namespace can still hold the first image.
        """
        self.unmount()
        self._cuts += 1
        again = self.image.with_name(f"image{self._cuts}")
        _run("cp", "--sparse=always", self.image, again)
        self.image.unlink()
        self.image = again
        self._mount()

    def unmount(self) -> None:
        """Unmount; waits for processes that still use it."""
        for _ in range(50):
            done = subprocess.run(["umount", self.root], capture_output=True, text=True, check=False)
            if done.returncode == 0 or "not mounted" in done.stderr:
                return
            time.sleep(0.1)
        raise OSError(done.stderr.strip())


@contextlib.contextmanager
def disk(folder: Path, megabytes: int = 64) -> Iterator[Disk]:
    """Make a disk, and unmount it at the end."""
    made = Disk(folder, megabytes)
    try:
        yield made
    finally:
        made.unmount()


@contextlib.contextmanager
def small_folder(folder: Path, megabytes: float) -> Iterator[Path]:
    """A file system in memory with this capacity [MB]."""
    folder.mkdir()
    _run("mount", "-t", "tmpfs", "-o", f"size={round(megabytes * 1e6)}", "none", folder)
    try:
        yield folder
    finally:
        _run("umount", "-l", folder)


def fill(folder: Path) -> Path:
    """Fill the file system; returns the file that fills it."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        for size in (2**16, 2**12, 1):
            with contextlib.suppress(OSError):
                while file.write(bytes(size)):
                    pass
    return ballast


def cannot_cut() -> str:
    """Reason why this machine cannot simulate a power cut; empty when it can."""
    if os.getuid() != 0:
        return "needs root"
    if missing := [tool for tool in ("mkfs.ext4", "mount", "umount") if shutil.which(tool) is None]:
        return f"needs {', '.join(missing)}"
    if not Path("/dev/loop-control").exists():
        return "needs loop devices"
    return ""


def cannot_mount() -> str:
    """Reason why this machine cannot mount a small file system; empty when it can."""
    return "needs root" if os.getuid() != 0 else ""


def _run(*command: object) -> None:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
