"""Measurement of the wake-up lateness of this machine, and of the highest rate that it holds."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.config import RealTimeConfig
from piezod.control.rate_keeper import RealRateKeeper
from piezod.control.realtime import real_time

RATES_HZ = (200.0, 500.0, 1000.0, 2000.0, 4000.0)


@dataclass(frozen=True)
class Lateness:
    """Measured lateness at one rate.

    Parameters
    ----------
    rate_Hz
        Wake-ups per second [Hz].
    lateness_us
        Lateness of each wake-up, shape (N,) [us].
    """

    rate_Hz: float
    missed: int
    lateness_us: NDArray[np.float64]


def measure_lateness(rate_Hz: float, duration_s: float, config: RealTimeConfig) -> Lateness:
    """Measure the lateness of wake-ups at one rate, without any work in between.

    Parameters
    ----------
    rate_Hz
        Wake-ups per second [Hz].
    duration_s
        Duration of the measurement [s].
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
    """Highest measured rate with at most one missed tick in ten thousand [Hz]; None without such a rate."""
    held = [lateness.rate_Hz for lateness in measured if lateness.missed <= 1e-4 * lateness.lateness_us.size]
    return max(held, default=None)
