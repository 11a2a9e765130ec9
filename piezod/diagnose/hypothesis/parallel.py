"""Independent fits in threads: compiled loops and linear algebra release the interpreter."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Argument = TypeVar("Argument")
Result = TypeVar("Result")


def core_count() -> int:
    """Number of cores that this process may use; of all cores where the system sets no affinity."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> int:
    """Number of threads: OMP_NUM_THREADS where it is set, else the cores that this process may use."""
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return int(stated) if stated.isdecimal() and int(stated) > 0 else core_count()


def each(work: Callable[[Argument], Result], arguments: Iterable[Argument]) -> list[Result]:
    """Results in the order of the arguments.

    Raises
    ------
    Exception
        The first exception that `work` raised.
    """
    waiting = list(arguments)
    count = min(threads(), len(waiting))
    if count < 2:
        return [work(argument) for argument in waiting]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, waiting))
