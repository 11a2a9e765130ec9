"""Elasto-plastic friction, measured in force: purely elastic up to break-away, then more and more plastic.

With the bristle's deflection z in parts of its limit and the travel x in force (the form is chosen here, after the
elasto-plastic models of presliding):

    dz/dx = s (1 - a(z) z sgn(dx)),    a = 0 below break-away, 1 at the limit, half a sine wave in between,

and a = 0 whenever the motion unloads the bristle. s is such that 63 % is there after a given travel from rest.
"""

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

FINEST = 0.02  # of the presliding travel: a longer step is taken in parts
REACHED = 1.0 - np.exp(-1.0)
CURVE_POINTS = 4000


def rub(force_N: Array, coulomb_N: float, presliding_N: float, break_away: float) -> Array:
    """Friction that opposes a motion, shape (n,) [N].

    Parameters
    ----------
    force_N
        The motion, measured in the force that it brings, shape (n,) [N].
    coulomb_N
        Limit of the friction [N].
    presliding_N
        Travel from rest after which 63 % of it are there [N].
    break_away
        Part of the limit up to which it is elastic, 0 to 1.
    """
    result: Array = coulomb_N * _run(force_N / presliding_N, stiffness(break_away), break_away)
    return result


def stiffness(break_away: float) -> float:
    """Initial slope of the relative friction over the travel in parts of the presliding one (1)."""
    travel = np.linspace(0.0, 4.0, CURVE_POINTS)
    return float(np.interp(REACHED, _run(travel, 1.0, break_away), travel))


@njit(cache=True)
def _run(x: Array, slope: float, break_away: float) -> Array:
    out = np.empty(x.size)
    z, last = 0.0, x[0]
    for k in range(x.size):
        travel = x[k] - last
        last = x[k]
        if travel != 0.0:
            parts = int(abs(travel) / FINEST) + 1
            part = travel / parts
            for _ in range(parts):
                half = z + 0.5 * part * slope * _yielding(z, part, break_away)
                z += part * slope * _yielding(half, part, break_away)
        out[k] = z
    return out


@njit(cache=True)
def _yielding(z: float, way: float, break_away: float) -> float:
    """Part of the travel that stretches the bristle."""
    size = abs(z)
    if z * way <= 0.0 or size <= break_away:
        return 1.0
    if size >= 1.0:
        return 0.0
    middle = 0.5 * (1.0 + break_away)
    plastic = 0.5 + 0.5 * np.sin(np.pi * (size - middle) / (1.0 - break_away))
    left: float = 1.0 - plastic * size
    return left
