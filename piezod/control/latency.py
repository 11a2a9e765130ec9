"""How late this machine wakes up, and the highest rate it holds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.config import RealTimeConfig
from piezod.control.rate_keeper import RealRateKeeper
from piezod.control.realtime import real_time

RATES_HZ = (200.0, 500.0, 1000.0, 2000.0, 4000.0)


@dataclass(frozen=True)
class Lateness:
    """Wake-ups at one rate."""

    rate_Hz: float
    missed: int
    lateness_us: NDArray[np.float64]


def measure_lateness(rate_Hz: float, duration_s: float, config: RealTimeConfig) -> Lateness:
    """Keep a rate without doing anything in between.

    Parameters
    ----------
    rate_Hz
        Wake-ups a second.
    duration_s
        How long [s].
    config
        What is asked of the kernel.
    """
    count = max(2, round(rate_Hz * duration_s))
    lateness_ns = np.zeros(count)
    keeper = RealRateKeeper(1.0 / rate_Hz)
    with real_time(config):
        keeper.start()
        for k in range(count):
            keeper.wait()
            lateness_ns[k] = keeper.lateness_ns
    return Lateness(rate_Hz, keeper.missed, lateness_ns * 1e-3)


def rate_held_Hz(measured: list[Lateness]) -> float | None:
    """Highest measured rate of which at most one tick in ten thousand was missed; None when there is none."""
    held = [one.rate_Hz for one in measured if one.missed <= 1e-4 * one.lateness_us.size]
    return max(held, default=None)
