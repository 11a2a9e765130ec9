"""A virtual environment for every peer, created once in a cache folder, with pinned packages."""

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from piezod.errors import TemporaryError

CONSTRAINTS = Path(__file__).with_name("constraints.txt")
READY = "ready"
WITHIN_s = 900.0


def cache_folder() -> Path:
    """Default folder of the environments."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "piezod-peers"


def interpreter(name: str, packages: Sequence[str], cache: Path) -> Path:
    """The Python interpreter of an environment with these packages; creates a missing environment.

    Parameters
    ----------
    name
        Name of the peer.
    packages
        As pip takes them; versions are those of `constraints.txt`.
    cache
        Folder of the environments.

    Raises
    ------
    TemporaryError
        They cannot be installed.
    """
    text = "\n".join([sys.version, *packages, CONSTRAINTS.read_text(encoding="utf-8")])
    folder = cache / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    python = folder / "bin" / "python"
    if not (folder / READY).is_file():
        shutil.rmtree(folder, ignore_errors=True)
        cache.mkdir(parents=True, exist_ok=True)
        _run(name, sys.executable, "-m", "venv", folder)
        pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check")
        _run(name, python, *pip, "--constraint", CONSTRAINTS, *packages)
        (folder / READY).touch()
    return python


def _run(name: str, *command: object) -> None:
    try:
        done = subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=WITHIN_s, check=False)
        code, messages = done.returncode, done.stderr.strip().splitlines()
    except (OSError, subprocess.TimeoutExpired) as error:
        code, messages = 1, [str(error)]
    if code != 0:
        wrong = [line for line in messages if line.startswith("ERROR")] or messages or ["no message"]
        raise TemporaryError(f"environment of {name}: not made: {wrong[-1]}; leave it out with --peers, or try again")
