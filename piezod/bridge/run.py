"""Run the bridges of a bench until SIGINT or SIGTERM."""

import asyncio
import os
import signal
from collections.abc import Callable, Coroutine
from typing import Any

NICENESS = 10  # control comes first


async def until_signal(*bridges: Coroutine[Any, Any, None]) -> None:
    """Run bridges beside each other; the first that fails ends all.

    Parameters
    ----------
    bridges
        Each runs until it is cancelled.

    Raises
    ------
    PiezodError
        A bridge cannot run.
    """
    os.setpriority(os.PRIO_PROCESS, 0, max(NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))
    end = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    tasks = [loop.create_task(bridge) for bridge in bridges]
    ended = loop.create_task(end.wait())
    done, _ = await asyncio.wait([*tasks, ended], return_when=asyncio.FIRST_COMPLETED)
    for task in (*tasks, ended):
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    for task in done - {ended}:
        task.result()


def run_bridges(make: Callable[[], list[Coroutine[Any, Any, None]]]) -> None:
    """Run bridges until a signal.

    Parameters
    ----------
    make
        Makes them, within the event loop.
    """

    async def run() -> None:
        await until_signal(*make())

    asyncio.run(run())
