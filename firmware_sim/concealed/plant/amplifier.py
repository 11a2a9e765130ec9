"""The amplifier of a concealed plant: clamp with a soft knee, limited current, lag into a growing capacitance.

All three laws and their solutions are derived here.

- Clamp: `v = limit - k ln(1 + exp((limit - u) / k))` with the knee k [V], shifted so that 0 V stays 0 V.
- Current: `du/dt = limit tanh((target - u) / (limit tau))` with a very short tau. For a held target,
  `sinh((target - u) / (limit tau))` decays as exp(-t / tau), which is exact.
- Lag: `du/dt = (target - u) / tau(u)`. The capacitance grows with the voltage; tau is stated at half range.
"""

import math

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

STEEP = 20.0  # gap over (limit tau) above which the slew rate equals the limit


def clamp(voltage_V: Array, limit_V: float, knee_V: float) -> Array:
    """Clamped voltage: smooth minimum of command and limit, with a knee of about `knee_V`, shape (n,) [V].

    Parameters
    ----------
    voltage_V
        Command, shape (n,) [V].
    limit_V
        Highest output voltage [V], above 0.
    knee_V
        Width of the knee [V], above 0.
    """
    below = (limit_V - voltage_V) / knee_V
    clamped = limit_V - knee_V * np.logaddexp(0.0, below)
    # The shift keeps 0 V at 0 V.
    result: Array = np.maximum(clamped + knee_V * np.logaddexp(0.0, limit_V / knee_V) - limit_V, 0.0)
    return result


@njit(cache=True)
def rate_limited(voltage_V: Array, limit_V_per_s: float, dt_s: float) -> Array:
    """Commands with a limited rate of change, shape (n,) [V].

    Parameters
    ----------
    voltage_V
        Command, shape (n,) [V], n at least 1.
    limit_V_per_s
        Highest rate of change [V/s], above 0.
    dt_s
        Sample period [s], above 0.
    """
    out = np.empty(voltage_V.size)
    most, now = limit_V_per_s * dt_s, voltage_V[0]
    for k in range(voltage_V.size):
        now += min(max(voltage_V[k] - now, -most), most)
        out[k] = now
    return out


@njit(cache=True)
def slew(voltage_V: Array, limit_V_per_s: float, tau_s: float, dt_s: float, held: bool) -> Array:
    """Output voltage behind a slew limit, shape (n,) [V].

    Parameters
    ----------
    voltage_V
        Target, shape (n,) [V].
    limit_V_per_s
        Largest rate [V/s].
    tau_s
        Time constant below the limit [s], much shorter than a sample.
    dt_s
        Step of the grid [s].
    held
        True: the target is held over a step. False: the target is at the end of its straight line already; tau is too
        short for the difference to matter.
    """
    out = np.empty(voltage_V.size)
    width, keep = limit_V_per_s * tau_s, math.exp(-dt_s / tau_s)
    now, last = voltage_V[0], voltage_V[0]
    for k in range(voltage_V.size):
        target = last if held else voltage_V[k]
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
def swelling_lag(voltage_V: Array, tau_s: float, swell: float, reach_V: float, dt_s: float, held: bool) -> Array:
    """Voltage behind a first-order lag whose time constant grows with the voltage, shape (n,) [V].

    A step is solved exactly for the capacitance at its beginning.

    Parameters
    ----------
    voltage_V
        Target, shape (n,) [V].
    tau_s
        Time constant at half range [s].
    swell
        Relative change of the time constant from half range to either end (1).
    reach_V
        Largest voltage [V].
    dt_s
        Step of the grid [s].
    held
        True: the target is held over a step. False: it runs straight to the next value.
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
        rise = 0.0 if held else voltage_V[k + 1] - start
        now = now * fade + start * (1.0 - fade) + rise * (1.0 - (1.0 - fade) / ratio)
    return out
