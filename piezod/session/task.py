"""What a control process is given, and what comes of it.

Light to import: the control process is started first, and loads what it needs while its parent does the same.
"""

from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from piezod.config import BenchConfig
from piezod.session.lock import BenchLock

if TYPE_CHECKING:
    from piezod.model import Model
    from piezod.session.assembly import Work


@dataclass(frozen=True)
class Task:
    """What a control process is given.

    Parameters
    ----------
    bench, model, folder
        What `load` read, and the folder that relative paths start from.
    works
        Driven one after the other; none: the bench is only read, until stopped.
    serves
        Follow the own reference of this configuration with its own model whenever told to, and stay disarmed
        otherwise, until stopped.
    """

    bench: BenchConfig
    model: "Model | None"
    folder: Path
    works: "tuple[Work, ...]"
    serves: Path | None = None


@dataclass
class Outcome:
    """What a session came to."""

    ticks: int = 0
    missed: int = 0
    failed_exchanges: int = 0
    results: dict[str, int] = field(default_factory=dict)
    fault: str = ""
    stopped: bool = False
    warnings: list[str] = field(default_factory=list)
    resident_kib: int = 0
    stale_bytes: int = 0
    spikes: int = 0
    hint: str = ""


def control(task: Task, pipe: Connection, lock: BenchLock) -> None:
    """Enter the control process."""
    from piezod.session.control_process import run  # noqa: PLC0415  # only here, not in the process that starts it

    run(task, pipe, lock)
