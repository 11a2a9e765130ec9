"""Progress of a long task on stderr: a bar on a terminal, else a line every ten seconds."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

SHOW_AFTER_S = 2.0  # a shorter task shows no bar [s]
LINE_EVERY_S = 10.0  # between two lines where stderr is no terminal [s]; a shorter task prints none
TELLING_SHARE = 0.05  # share of a task from which the time left follows


class _Lines:
    """Lines on stderr with the current step, the completed share and the remaining time."""

    def __init__(self) -> None:
        self._start_s = self._last_s = time.monotonic()

    def show(self, step: str, share: float | None) -> None:
        """Print a line where it is time for one."""
        now_s = time.monotonic()
        if now_s - self._last_s < LINE_EVERY_S:
            return
        self._last_s = now_s
        elapsed_s = now_s - self._start_s
        done = "" if share is None else f", {100.0 * share:.0f} %"
        remaining = ""
        if share is not None and share >= TELLING_SHARE:
            remaining = f", about {elapsed_s * (1.0 - share) / share:.0f} s left"
        sys.stderr.write(f"{step}{done}, {elapsed_s:.0f} s taken{remaining}\n")
        sys.stderr.flush()


@contextlib.contextmanager
def steps(show_after_s: float = SHOW_AFTER_S) -> Iterator[Callable[[str, float | None], None]]:
    """Yield a function that shows the name of the current step and the completed share, 0 to 1 or None if unknown.

    The bar appears at the first call after `show_after_s`, and disappears at the end. Where the output is no
    terminal, a line is printed every ten seconds.

    Parameters
    ----------
    show_after_s
        Delay before the bar appears [s]; 0 for a task that is known to be long.
    """
    if not (sys.stdout.isatty() and sys.stderr.isatty()):
        yield _Lines().show
        return
    start_s = time.monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("", total=None)

    def show(step: str, share: float | None) -> None:
        if time.monotonic() - start_s >= show_after_s:
            bar.start()
            bar.update(task, description=step, total=None if share is None else 1.0, completed=share or 0.0)

    try:
        yield show
    finally:
        bar.stop()


@contextlib.contextmanager
def progress(label: str, duration_s: float) -> Iterator[Callable[[NDArray[np.void]], None]]:
    """Yield a function that advances the bar to the time stamp of the newest of the given ring-log rows.

    Parameters
    ----------
    label
        Text next to the bar.
    duration_s
        Expected duration [s].
    """
    first_ns: int | None = None

    def passed_s(rows: NDArray[np.void]) -> float:
        nonlocal first_ns
        first_ns = first_ns if first_ns is not None else int(rows["time_ns"][0])
        return (int(rows["time_ns"][-1]) - first_ns) * 1e-9

    if not sys.stderr.isatty():
        lines = _Lines()
        yield lambda rows: lines.show(label, min(passed_s(rows) / duration_s, 1.0)) if len(rows) else None
        return
    console = Console(stderr=True)
    with Progress(
        TextColumn(label), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn(), console=console
    ) as bar:
        task = bar.add_task(label, total=duration_s)
        yield lambda rows: bar.update(task, completed=passed_s(rows)) if len(rows) else None
        bar.update(task, completed=duration_s)
