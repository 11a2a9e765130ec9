"""Progress bars on a terminal. Without a terminal nothing is shown."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

SHOW_AFTER_S = 2.0
"""A shorter task shows no bar [s]."""


@contextlib.contextmanager
def steps(show_after_s: float = SHOW_AFTER_S) -> Iterator[Callable[[str, float | None], None]]:
    """Yield a function that shows the name of the current step and the completed share, 0 to 1 or None if unknown.

    The bar appears at the first call after `show_after_s`, and disappears at the end.

    Parameters
    ----------
    show_after_s
        Delay before the bar appears [s]; 0 for a task that is known to be long.
    """
    if not (sys.stdout.isatty() and sys.stderr.isatty()):
        yield lambda *_: None
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
        Text beside the bar.
    duration_s
        Expected duration [s].
    """
    console = Console(stderr=True)
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Progress(
        TextColumn(label), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn(), console=console
    ) as bar:
        task = bar.add_task(label, total=duration_s)
        first_ns: int | None = None

        def show(rows: NDArray[np.void]) -> None:
            nonlocal first_ns
            if len(rows):
                first_ns = first_ns if first_ns is not None else int(rows["time_ns"][0])
                bar.update(task, completed=(int(rows["time_ns"][-1]) - first_ns) * 1e-9)

        yield show
        bar.update(task, completed=duration_s)
