"""Removes outdated entries of numba's cache of compiled kernels.

Numba compares a cached function only with the file that defines it. The loops in `kernels.py` call kernels of other
files. After a change of such a file alone, numba would run the outdated loop.
"""

import functools
from pathlib import Path

from firmware_sim.physics.kernels import advance


@functools.cache
def remove_outdated_kernels() -> None:
    """Remove the outdated compiled kernels of this folder; acts once per process."""
    if advance.stats.cache_path is not None:
        remove_older_than_sources(Path(__file__).parent, Path(advance.stats.cache_path))


def remove_older_than_sources(sources: Path, cache: Path) -> None:
    """Remove the index of every cached kernel that is older than the newest source.

    Parameters
    ----------
    sources
        Folder of the Python sources.
    """
    newest_s = max(source.stat().st_mtime for source in sources.glob("*.py"))
    for index in cache.glob("*.nbi"):
        try:
            if index.stat().st_mtime < newest_s:
                index.unlink()
        except OSError:  # removed by another process, or no permission
            continue
