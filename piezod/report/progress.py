"""A progress bar on a terminal, nothing elsewhere."""

import contextlib
import sys
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


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
