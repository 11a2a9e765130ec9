"""The amplifier of a concealed plant: a soft-kneed clamp, an input stage that runs out of current, a swelling load.

- Current: `du/dt = limit tanh((target - u) / (limit tau))` with a very short tau: sinh of the gap over (limit tau)
  decays exponentially, which is exact for a held target.
- Lag: `du/dt = (target - u) / tau(u)` with a capacitance that grows with the voltage; tau is meant at half range.
"""

import math

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

STEEP = 20.0  # gap over (limit tau) above which the stage gives all it has


def clamp(voltage_V: Array, limit_V: float, knee_V: float) -> Array:
    """Output stage that runs out of supply: the smooth minimum of command and limit, bent over about `knee_V` [V]."""
    below = (limit_V - voltage_V) / knee_V
    clamped = limit_V - knee_V * np.logaddexp(0.0, below)
    # A voltage of zero stays zero.
    result: Array = np.maximum(clamped + knee_V * np.logaddexp(0.0, limit_V / knee_V) - limit_V, 0.0)
    return result


@njit(cache=True)
def rate_limited(voltage_V: Array, limit_V_per_s: float, dt_s: float) -> Array:
    """Commands that a careful operator gives: never faster than a limit [V]."""
    out = np.empty(voltage_V.size)
    most, now = limit_V_per_s * dt_s, voltage_V[0]
    for k in range(voltage_V.size):
        now += min(max(voltage_V[k] - now, -most), most)
        out[k] = now
    return out


@njit(cache=True)
def slew(voltage_V: Array, limit_V_per_s: float, tau_s: float, dt_s: float, stairs: bool) -> Array:
    """Voltage of a stage that gives `limit_V_per_s` at most [V].

    A straight target counts as being at its end already: it moves by less than the stage's tau tells apart.
    """
    out = np.empty(voltage_V.size)
    width, keep = limit_V_per_s * tau_s, math.exp(-dt_s / tau_s)
    now, last = voltage_V[0], voltage_V[0]
    for k in range(voltage_V.size):
        target = last if stairs else voltage_V[k]
        last = voltage_V[k]
        way = 1.0 if target > now else -1.0
        gap, left_s = abs(target - now), dt_s
        steep = STEEP * width
        if gap > steep:
            straight = min(gap - steep, limit_V_per_s * dt_s)
            gap -= straight
            left_s -= straight / limit_V_per_s
        if left_s > 0.0 and gap > 0.0:
            fade = keep if left_s == dt_s else math.exp(-left_s / tau_s)
            gap = width * math.asinh(math.sinh(min(gap / width, STEEP)) * fade)
        now = target - way * gap
        out[k] = now
    return out


@njit(cache=True)
def swelling_lag(voltage_V: Array, tau_s: float, swell: float, reach_V: float, dt_s: float, stairs: bool) -> Array:
    """First-order lag whose time constant is `tau_s` at half range and `1 +- swell` of it at the ends [V].

    Exact within a step for the capacitance at its beginning, the target held (`stairs`) or straight.
    """
    out = np.empty(voltage_V.size)
    now = voltage_V[0]
    for k in range(voltage_V.size):
        out[k] = now
        if k + 1 == voltage_V.size:
            break
        tau = tau_s * (1.0 + swell * (2.0 * now / reach_V - 1.0))
        ratio = dt_s / tau
        fade = math.exp(-ratio)
        start = voltage_V[k]
        rise = 0.0 if stairs else voltage_V[k + 1] - start
        now = now * fade + start * (1.0 - fade) + rise * (1.0 - (1.0 - fade) / ratio)
    return out
