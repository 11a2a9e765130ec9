"""Independent fits beside each other, in threads: compiled loops and linear algebra let go of the interpreter."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

One = TypeVar("One")
Result = TypeVar("Result")


def threads() -> int:
    """How many: OMP_NUM_THREADS where it is set, else the processor cores that this process may use."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdecimal() and int(asked) > 0 else len(os.sched_getaffinity(0))


def each(work: Callable[[One], Result], of: Iterable[One]) -> list[Result]:
    """Results in the order of the arguments.

    Raises
    ------
    Exception
        The first that a piece of work raised.
    """
    todo = list(of)
    count = min(threads(), len(todo))
    if count < 2:
        return [work(one) for one in todo]
    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(work, todo))
