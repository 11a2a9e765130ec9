"""The process of one task: it works on the files of the task, and ends with its parent process."""

import os
import shutil
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path

from piezod.errors import PiezodError


def serve(work: Callable[[Path], None], fail: Callable[[Path, str], None]) -> None:
    """Work on the task of the command line, `MODULE TASK OUTCOME`.

    Parameters
    ----------
    work
        Called with the folder of the outcome, which does not exist yet. The folder of the task, within a temporary
        folder for it alone, is the current directory.
    fail
        Called with the existing folder of the outcome and the error in a line, if `work` raised one.
    """
    task, outcome = map(Path, sys.argv[1:])
    threading.Thread(target=_end_with_parent, args=(task.parent,), daemon=True).start()
    os.chdir(task)
    try:
        work(outcome)
    except Exception as error:  # noqa: BLE001  # any error is a failure that must count
        outcome.mkdir(exist_ok=True)
        fail(outcome, _line(error))


def _end_with_parent(scratch: Path) -> None:
    """Wait until the parent's end of standard input is closed, delete the temporary folder and end this process."""
    os.read(sys.stdin.fileno(), 1)  # unbuffered: a held lock of the buffer would block the exit
    shutil.rmtree(scratch, ignore_errors=True)
    os._exit(1)


def _line(error: Exception) -> str:
    """Message of an error; for an unexpected error also its type and place."""
    if isinstance(error, PiezodError):
        return str(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(place.filename).name}, line {place.lineno}: {error}"
