"""Processes: their numbers, start, signals and end."""

import asyncio
import ctypes
import multiprocessing
import os
import signal
from multiprocessing.context import SpawnContext
from multiprocessing.reduction import DupFd
from typing import Any

from piezod.runtime.interpreter import protect_spawned, python

_PR_SET_PDEATHSIG = 1  # prctl(2): the signal that the kernel sends when the parent dies

number = os.getpid
"""Number of this process."""
pid_descriptor = os.pidfd_open
"""Descriptor of a process, which never means another one, as `os.pidfd_open`."""
send_signal = signal.pidfd_send_signal
"""Send a signal to the process of a descriptor, as `signal.pidfd_send_signal`."""


def spawn_context() -> SpawnContext:
    """Context of `multiprocessing` whose processes start from nothing."""
    protect_spawned()
    return multiprocessing.get_context("spawn")


def passed_descriptor(descriptor: int) -> Any:  # noqa: ANN401  # its type depends on the start method
    """A descriptor as an argument of a process that is being spawned; `detach` returns it there."""
    return DupFd(descriptor)


def end_with_parent(number: int) -> bool:
    """Request a signal at the death of the parent; False when it has died already, which sends no signal."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
    parent = multiprocessing.parent_process()
    return parent is None or parent.pid == os.getppid()


async def start_module(module: str, argument: str, longest_line: int) -> asyncio.subprocess.Process:
    """Start a module with one argument, and with pipes for standard input and output.

    Parameters
    ----------
    longest_line
        Limit of a line that is read from it [byte].

    Raises
    ------
    OSError
        The process cannot be started.
    """
    pipe = asyncio.subprocess.PIPE
    return await asyncio.create_subprocess_exec(
        *python("-m", module, argument), stdin=pipe, stdout=pipe, limit=longest_line
    )
