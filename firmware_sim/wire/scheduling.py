"""A device is a machine of its own and waits for no scheduler here: let the emulated one be as punctual as it may."""

import contextlib
import gc
import os

PRIORITY = 70  # below a controller's usual 80, above everything ordinary


def be_punctual() -> None:
    """Take a real-time priority where that is allowed, and collect no garbage that stays anyway."""
    gc.collect()
    gc.freeze()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
