"""Limits of a bench file for the pauses of this machine, as measured by `piezod latency`."""

import math
from collections.abc import Sequence

from piezod.control.latency import Lateness, rate_held_Hz

MARGIN = 3.0  # factor on the longest pause seen: a test of seconds does not see the longest pause of a day
FEWEST_MISSED, LEAST_WATCHDOG_MS, LEAST_COMM_LOSS_MS = 5, 100, 200
"""Limits of the shipped bench; a fast machine keeps them."""
FEWEST_STALE_TICKS = 5  # ticks that a reading may be old on the shipped bench


def suggested_limits(measured: Sequence[Lateness]) -> dict[str, float]:
    """Highest rate that this machine holds, and the limits that its pauses need, by the keys of a bench file.

    The pause is the longest lateness at that rate, times `MARGIN`. Ticks and readings that are missing during a pause
    stay below the limits. The watchdog of the device waits twice as long, the loss of communication twice that.

    Parameters
    ----------
    measured
        Lateness at each rate, at least one. Without a rate that is held, the lowest one counts.
    """
    rate_Hz = rate_held_Hz(list(measured)) or min(lateness.rate_Hz for lateness in measured)
    worst_us = max(float(one.lateness_us.max()) for one in measured if one.rate_Hz == rate_Hz)
    tick_ms, pause_ms = 1000.0 / rate_Hz, MARGIN * 1e-3 * worst_us
    watchdog_ms = max(LEAST_WATCHDOG_MS, math.ceil(2.0 * max(pause_ms, 2.0 * tick_ms)))
    return {
        "rate_Hz": rate_Hz,
        "missed_ticks_in_a_row": max(FEWEST_MISSED, math.ceil(pause_ms / tick_ms)),
        "stale_after_ms": math.ceil(max(FEWEST_STALE_TICKS * tick_ms, pause_ms + tick_ms)),
        "device_watchdog_ms": watchdog_ms,
        "comm_loss_ms": max(LEAST_COMM_LOSS_MS, 2 * watchdog_ms),
    }


def limits_block(limits: dict[str, float]) -> str:
    """Lines of YAML to paste into a bench file.

    Parameters
    ----------
    limits
        Result of `suggested_limits`.
    """
    lines = [f"rate_Hz: {limits['rate_Hz']:g}", "limits:"]
    return "\n".join([*lines, *(f"  {key}: {value:g}" for key, value in limits.items() if key != "rate_Hz")])
