"""The command that starts a child with this interpreter: without the current folder on the path of its imports.

A `sqlite3.py` in the folder where somebody starts the program would else run in the child. PYTHONPATH counts as before.
"""

import os
import sys

_SAFE = "PYTHONSAFEPATH"


def python(*arguments: str) -> list[str]:
    """Command of a child.

    Parameters
    ----------
    arguments
        Arguments of the interpreter, such as `-m` and a module.
    """
    return [sys.executable, "-P", *arguments]


def protect_spawned() -> None:
    """Protect children of `multiprocessing` likewise; Python makes their command."""
    os.environ[_SAFE] = "1"
