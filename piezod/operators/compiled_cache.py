"""Keeps numba's cache honest: a compiled step must not outlive an edit of a step that it calls.

Numba compares a cached function only with the file it stands in. The steps of the Prandtl-Ishlinskii operator call
those of the plays and dead zones, so after an update of one of these files alone the old operator would go on running.
"""

import contextlib
import functools
from pathlib import Path

OPERATORS = Path(__file__).parent


@functools.cache
def forget_outdated_steps(cache_path: str, called: tuple[Path, ...] = (OPERATORS,)) -> None:
    """Once a process: remove every cached step that is older than the newest source of the steps that are called.

    Parameters
    ----------
    cache_path
        Where numba keeps the compiled steps (`step.stats.cache_path`).
    called
        Folders whose steps they call.
    """
    newest_s = max(source.stat().st_mtime for folder in called for source in folder.glob("*.py"))
    for index in Path(cache_path).glob("*.nbi"):
        with contextlib.suppress(OSError):  # another process was quicker, or the cache is not ours
            if index.stat().st_mtime < newest_s:
                index.unlink()
