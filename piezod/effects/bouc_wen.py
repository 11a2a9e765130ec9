"""A hysteresis whose memory fades with the way: Bouc's and Wen's state, the same for every rate and every sampling.

    dz/ds = 1 - |z|^n                    while |z| grows
    dz/ds = 1 - (1 - 2 closing) |z|^n    while it falls, s = |way| / scale

Along one direction z is a fixed function of s, which is tabled: a sample moves s on, a reversal mirrors z. closing = 1
and n = 1 is Dahl's solid friction; closing = 0.5 and a large n yields like a spring up to its limit, then slides.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NODES, FURTHEST = 1024, 24.0  # of the table; beyond that way the state no longer changes
ARISEN = 1.0 - math.exp(-1.0)  # of the limit, within `travel`


@numba.njit(cache=True, nogil=True)
def _rate(z: float, exponent: float, closing: float) -> float:
    """dz/ds while z moves upwards."""
    rate: float = 1.0 - abs(z) ** exponent * (1.0 if z > 0.0 else 1.0 - 2.0 * closing)
    return rate


@numba.njit(cache=True, nogil=True)
def _onwards(z: float, step: float, exponent: float, closing: float) -> float:
    """Runge's and Kutta's step of the fourth order."""
    a = _rate(z, exponent, closing)
    b = _rate(z + 0.5 * step * a, exponent, closing)
    c = _rate(z + 0.5 * step * b, exponent, closing)
    d = _rate(z + step * c, exponent, closing)
    return z + step * (a + 2.0 * b + 2.0 * c + d) / 6.0


@numba.njit(cache=True, nogil=True)
def _table(exponent: float, closing: float) -> tuple[Array, Array, float, float]:
    """State and its slope at equal steps of s from z = -1 on, the step, and s where z is 0."""
    below = 0.0
    z, step = 0.0, FURTHEST / NODES
    while z > -1.0:
        z = _onwards(z, -step, exponent, closing)
        below += step
    size = NODES + round(below / step)
    states, slopes = np.empty(size), np.empty(size)
    middle = size - NODES
    states[middle] = 0.0
    for k in range(middle + 1, size):
        states[k] = min(_onwards(states[k - 1], step, exponent, closing), 1.0)
    for k in range(middle - 1, -1, -1):
        states[k] = _onwards(states[k + 1], -step, exponent, closing)
    for k in range(size):
        slopes[k] = max(_rate(states[k], exponent, closing), 0.0)
    return states, slopes, step, middle * step


@numba.njit(cache=True, nogil=True)
def _at(s: float, states: Array, slopes: Array, step: float) -> float:
    """State at a way, by cubics through the table's values and slopes."""
    k = min(int(s / step), states.size - 2)
    t = min(s / step - k, 1.0)
    rise = states[k + 1] - states[k]
    first, last = step * slopes[k] - rise, rise - step * slopes[k + 1]
    z: float = states[k] + t * (rise + (1.0 - t) * (first * (1.0 - t) + last * t))
    return z


@numba.njit(cache=True, nogil=True)
def _way_to(z: float, states: Array, slopes: Array, step: float) -> float:
    """The way at which a state is reached."""
    k = min(max(int(np.searchsorted(states, z)), 1), states.size - 1) - 1
    low, high = k * step, (k + 1) * step
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _at(middle, states, slopes, step) < z:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@numba.njit(cache=True, nogil=True)
def bouc_wen(path: Array, x: Array, travel: float, exponent: float, closing: float) -> Array:
    """The state over a record, from 0 at the beginning of what led to it.

    Parameters
    ----------
    path
        Values before the first sample; empty: the state is 0 at the first sample.
    x
        What moves it, shape (N,).
    travel
        Way, in units of x, within which 63 % arise from 0.
    exponent, closing
        n, above 0, and how far a loop closes, 0.2 to 1.

    Returns
    -------
    ndarray
        States between -1 and 1, shape (N,).

    Raises
    ------
    ValueError
        The travel or the exponent is not above 0.
    """
    if not (travel > 0.0 and exponent > 0.0):
        raise ValueError("travel and exponent must be above 0")
    states, slopes, step, begin = _table(exponent, closing)
    scale = travel / (_way_to(ARISEN, states, slopes, step) - begin)
    out = np.empty(x.size)
    before = path[0] if path.size else x[0]
    z, s, sign = 0.0, begin, 1.0
    for k in range(path.size + x.size):
        now = path[k] if k < path.size else x[k - path.size]
        way = (now - before) / scale
        if way != 0.0:
            if way * sign < 0.0:
                sign = -sign
                s = _way_to(-z, states, slopes, step)
            s += abs(way)
            z = _at(s, states, slopes, step)
            before = now
        if k >= path.size:
            out[k - path.size] = sign * z
    return out
