"""A place for compiled functions where neither the package nor the user's cache is writable, as in a container.

Numba keeps compiled functions in the folder of the source, or in the user's cache folder. With neither, it refuses to
compile. This process and its children then share a private folder, which goes with the process.

Modules of the standard library are imported where they are needed: each command imports this module.
"""

import atexit
import os
import sys
from importlib import import_module
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
VARIABLE = "NUMBA_CACHE_DIR"
NOTE = f"piezod: no writable place for compiled code, it is compiled anew in each run; set {VARIABLE} to keep it\n"


def provide_folder() -> None:
    """Set `NUMBA_CACHE_DIR` to a private folder if compiled functions have no other place."""
    if os.environ.get(VARIABLE) or os.name != "posix":
        return
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path(os.environ.get("HOME", "/")) / ".cache")
    if os.access(PACKAGE, os.W_OK) or _can_be_written(caches / "numba"):
        return
    try:
        folder = import_module("tempfile").mkdtemp(prefix="piezod-compiled-")
    except OSError:
        return
    os.environ[VARIABLE] = folder
    atexit.register(_remove, folder, os.getpid())


def _can_be_written(folder: Path) -> bool:
    """Whether a folder, or the nearest folder above it that exists, is writable."""
    nearest = next((path for path in (folder, *folder.parents) if path.exists()), Path("/"))
    return nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK)


def _remove(folder: str, process: int) -> None:
    """Remove the folder at the end of the process that made it; report it if something was compiled."""
    if os.getpid() != process:
        return
    if any(Path(folder).rglob("*.nb?")):
        sys.stderr.write(NOTE)
    import_module("shutil").rmtree(folder, ignore_errors=True)
