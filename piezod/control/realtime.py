"""Real-time settings of the operating system and of Python; each is optional.

Measured on two cores without PREEMPT_RT: without SCHED_FIFO a loaded machine loses whole periods. A full garbage
collection with numba imported takes 8 to 9 ms. Deep sleep states of the cores delay a wake-up by tens of microseconds.
"""

import contextlib
import ctypes
import gc
import os
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path

from piezod.config import RealTimeConfig

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4  # ONFAULT: a page that is never used needs no memory
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30  # prctl(2)
LEAST_SLACK_NS = 1
_DMA_LATENCY = Path("/dev/cpu_dma_latency")


class RealTimeWarning(UserWarning):
    """A real-time right is missing; the loop runs without it."""


@contextlib.contextmanager
def real_time(config: RealTimeConfig) -> Iterator[None]:
    """Run the body with the real-time settings of `config`; all are undone at the end.

    Parameters
    ----------
    config
        Section `real_time` of the bench configuration.

    Warns
    -----
    RealTimeWarning
        A setting cannot be made; the message names the remedy.
    """
    with contextlib.ExitStack() as undo:
        if config.lock_memory:
            _try(_lock_memory, "real_time.lock_memory", "set LimitMEMLOCK=infinity or ulimit -l unlimited")
            undo.callback(ctypes.CDLL(None).munlockall)
        if config.cpu is not None:
            undo.callback(os.sched_setaffinity, 0, os.sched_getaffinity(0))
            cores = {config.cpu}
            _try(
                lambda: os.sched_setaffinity(0, cores),
                "real_time.cpu",
                f"choose an allowed core instead of {config.cpu}",
            )
        if config.hold_cpu_latency:
            _try(
                lambda: undo.enter_context(_zero_latency()),
                "real_time.hold_cpu_latency",
                f"allow writing to {_DMA_LATENCY}",
            )
        if config.fifo_priority:
            undo.callback(os.sched_setscheduler, 0, os.sched_getscheduler(0), os.sched_getparam(0))
            parameter = os.sched_param(config.fifo_priority)
            _try(
                lambda: os.sched_setscheduler(0, os.SCHED_FIFO, parameter),
                "real_time.fifo_priority",
                "set LimitRTPRIO=99 or run as root",
            )
        if os.sched_getscheduler(0) not in (os.SCHED_FIFO, os.SCHED_RR):
            undo.enter_context(_least_timer_slack())
        undo.enter_context(_frozen_collector())
        yield


def _try(setting: object, key: str, remedy: str) -> None:
    try:
        setting()  # type: ignore[operator]  # any callable without arguments
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        warnings.warn(f"{key}: {reason}; {remedy}, or switch it off", RealTimeWarning, stacklevel=4)


def _lock_memory() -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


@contextlib.contextmanager
def _zero_latency() -> Iterator[None]:
    """Request a wake-up latency of zero; the kernel grants it as long as the file is open."""
    with _DMA_LATENCY.open("wb", buffering=0) as file:
        file.write(struct.pack("<i", 0))
        yield


@contextlib.contextmanager
def _least_timer_slack() -> Iterator[None]:
    """Let the kernel end a sleep of this thread on time; by default it may be 50 us late without SCHED_FIFO."""
    prctl = ctypes.CDLL(None).prctl
    before_ns = prctl(_PR_GET_TIMERSLACK)
    prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(LEAST_SLACK_NS))
    try:
        yield
    finally:
        prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(max(0, before_ns)))


@contextlib.contextmanager
def _frozen_collector() -> Iterator[None]:
    """Collect once, then keep the garbage collector off."""
    was_on = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if was_on:
            gc.enable()
