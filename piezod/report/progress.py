"""A progress bar on a terminal, nothing elsewhere."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

PATIENCE_S = 2.0
"""What takes no longer needs no bar."""


@contextlib.contextmanager
def steps(patience_s: float = PATIENCE_S) -> Iterator[Callable[[str, float | None], None]]:
    """Yield a function to be called with what is done and the share of it that is done, None where nobody knows.

    The bar appears at the first call after some patience, and is gone at the end.

    Parameters
    ----------
    patience_s
        0 where the first call already knows that it will take long [s].
    """
    if not (sys.stdout.isatty() and sys.stderr.isatty()):
        yield lambda *_: None
        return
    begun_s = time.monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    task = bar.add_task("", total=None)

    def show(what: str, share: float | None) -> None:
        if time.monotonic() - begun_s >= patience_s:
            bar.start()
            bar.update(task, description=what, total=None if share is None else 1.0, completed=share or 0.0)

    try:
        yield show
    finally:
        bar.stop()


@contextlib.contextmanager
def progress(what: str, duration_s: float) -> Iterator[Callable[[NDArray[np.void]], None]]:
    """Yield a function to be called with new ring-log rows; the bar follows their time stamps.

    Parameters
    ----------
    what
        Said beside the bar.
    duration_s
        Expected length [s].
    """
    console = Console(stderr=True)
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Progress(
        TextColumn(what), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeRemainingColumn(), console=console
    ) as bar:
        task = bar.add_task(what, total=duration_s)
        first_ns: int | None = None

        def show(rows: NDArray[np.void]) -> None:
            nonlocal first_ns
            if len(rows):
                first_ns = first_ns if first_ns is not None else int(rows["time_ns"][0])
                bar.update(task, completed=(int(rows["time_ns"][-1]) - first_ns) * 1e-9)

        yield show
        bar.update(task, completed=duration_s)
