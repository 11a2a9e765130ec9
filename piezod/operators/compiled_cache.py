"""Removes compiled functions from numba's cache when a function that they call has changed.

Numba compares a cached function with its own file only. The steps of the Prandtl-Ishlinskii operator call steps of
other files. Without this module the old compiled code would still run after an update of such a file.
"""

import contextlib
import functools
from pathlib import Path

OPERATORS = Path(__file__).parent


@functools.cache
def forget_outdated_steps(cache_path: str, called: tuple[Path, ...] = (OPERATORS,)) -> None:
    """Remove the cached functions that are older than the newest source file that they may call; once per process.

    Parameters
    ----------
    cache_path
        Folder of the cached functions (`step.stats.cache_path`).
    called
        Folders of the functions that they call.
    """
    newest_s = max(source.stat().st_mtime for folder in called for source in folder.glob("*.py"))
    for index in Path(cache_path).glob("*.nbi"):
        with contextlib.suppress(OSError):  # another process removed it first, or the cache is read-only
            if index.stat().st_mtime < newest_s:
                index.unlink()
