"""Keeps numba's cache honest: a compiled loop must not outlive an edit of a kernel that it calls.

Numba compares a cached function only with the file in which it stands. The loops in `kernels.py` call kernels of other
files, so a change of one of these alone would go unnoticed and yesterday's physics would run.
"""

import functools
from pathlib import Path

from firmware_sim.physics.kernels import advance


@functools.cache
def forget_outdated_kernels() -> None:
    """Once a process: remove what is outdated of this package's compiled kernels."""
    if advance.stats.cache_path is not None:
        forget_older_than_sources(Path(__file__).parent, Path(advance.stats.cache_path))


def forget_older_than_sources(sources: Path, cache: Path) -> None:
    """Remove the index of every cached kernel that is older than the newest source."""
    newest_s = max(source.stat().st_mtime for source in sources.glob("*.py"))
    for index in cache.glob("*.nbi"):
        try:
            if index.stat().st_mtime < newest_s:
                index.unlink()
        except OSError:  # another process was quicker, or the cache is not ours
            continue
