"""The amplifier of a concealed plant: a soft-kneed clamp, a current limit, a lag."""

import numpy as np
from numba import njit

from firmware_sim.concealed.arrays import Array


def clamp(voltage_V: Array, limit_V: float, knee_V: float) -> Array:
    """Output stage that runs out of supply: the smooth minimum of command and limit, bent over about `knee_V` [V]."""
    below = (limit_V - voltage_V) / knee_V
    clamped = limit_V - knee_V * np.logaddexp(0.0, below)
    # A voltage of zero stays zero.
    result: Array = np.maximum(clamped + knee_V * np.logaddexp(0.0, limit_V / knee_V) - limit_V, 0.0)
    return result


@njit(cache=True)
def slew(voltage_V: Array, limit_V_per_s: float, dt_s: float) -> Array:
    """Follow a voltage on the grid with a rate of at most `limit_V_per_s` [V]."""
    out = np.empty(voltage_V.size)
    most, now = limit_V_per_s * dt_s, voltage_V[0]
    for k in range(voltage_V.size):
        now += min(max(voltage_V[k] - now, -most), most)
        out[k] = now
    return out
