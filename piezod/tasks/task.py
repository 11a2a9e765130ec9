"""A task: the contents of its files and the module that works on them, so another machine needs no shared disk."""

import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

RUN = "run.json"  # file that a process writes last; without it, the folder of an outcome is incomplete
MOST_REASON_TEXT = 500  # characters of the reason of a failure


@dataclass(frozen=True)
class Task:
    """Work for one process.

    Parameters
    ----------
    name
        Name of the task and of its outcome.
    files
        File name to content, compressed by zlib.
    module
        Module that is run with the folder of these files and the folder of the outcome as its arguments.
    """

    name: str
    files: dict[str, bytes]
    module: str

    def unpack(self, folder: Path) -> None:
        """Write the files into an existing folder."""
        for name, content in self.files.items():
            (folder / name).write_bytes(zlib.decompress(content))


@dataclass(frozen=True)
class Outcome:
    """Files that a task wrote.

    Parameters
    ----------
    files
        File name to content.
    failed
        Reason of the failure, one line; None: the task did not fail.
    """

    name: str
    files: dict[str, bytes]
    failed: str | None = None


TaskSource = Callable[[], Task | Outcome | None]
"""Called for the next task. An outcome: the task failed before it began. None: no task is ready.

After None it is called again when a running task has ended, because that may make others ready.
"""


def failed_outcome(name: str, reason: str) -> Outcome:
    """Outcome without files; `reason`: reason of the failure, shortened to one line."""
    return Outcome(name, {}, " ".join(reason.split())[:MOST_REASON_TEXT])


def read_outcome(name: str, folder: Path) -> Outcome | None:
    """Outcome in a folder; None: the folder holds no complete outcome."""
    try:
        files = {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}
        return Outcome(name, files, json.loads(files[RUN])["failed"])
    except (OSError, ValueError, KeyError):
        return None
