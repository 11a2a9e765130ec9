"""What several effects share, compiled once.

Steps of linear systems, exact for an input that runs straight between two samples; a memory that fades with the way.

A compiled step calls steps of its own file only: numba compares its cache with no other.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NODES, FURTHEST = 1024, 24.0  # of the table; beyond that way the state no longer changes
ABOUT_V, PER_V = 60.0, 100.0  # the middle of the usual stack's range: what a time constant and its swell belong to
LEAST = 0.2  # of a time constant, whatever the voltage
ARISEN = 1.0 - math.exp(-1.0)  # of the limit, within `travel`


@numba.njit(cache=True, nogil=True)
def first_order_step(y: float, before: float, now: float, keep: float, ramp: float) -> float:
    """Advance tau y' = x - y by a sample while x runs straight from `before` to `now`.

    With a = exp(-T / tau) = `keep` and b = 1 - tau (1 - a) / T = `ramp`: y <- a y + (1 - a - b) before + b now, written
    so that a resting state rests to the last digit.
    """
    return y + (1.0 - keep) * (before - y) + ramp * (now - before)


@numba.njit(cache=True, nogil=True)
def first_order_coefficients(time_constant_s: float, dt_s: float, hold: float = 0.0) -> tuple[float, float]:
    """`keep` and `ramp` of `first_order_step`; of a held input `ramp` is what its last part of a sample adds."""
    part = dt_s / time_constant_s
    keep = math.exp(-part)
    if hold > 0.0:
        return keep, -math.expm1(-part * min(hold, 1.0))
    ramp = 1.0 + math.expm1(-part) / part if part > 1e-6 else 0.5 * part
    return keep, ramp


@numba.njit(cache=True, nogil=True)
def first_order_run(x: Array, time_constant_s: float, dt_s: float, hold: float = 0.0) -> Array:
    """`first_order_step` over a record, from rest at its first sample; `hold` is the number of a `Hold`."""
    keep, ramp = first_order_coefficients(time_constant_s, dt_s, hold)
    out = np.empty(x.size)
    y = x[0]
    out[0] = y
    for k in range(1, x.size):
        y = first_order_step(y, x[k - 1], x[k], keep, ramp)
        out[k] = y
    return out


@numba.njit(cache=True, nogil=True)
def time_constant_at(voltage_V: float, time_constant_s: float, swell: float) -> float:
    """Of a lag into a capacitance that grows with its voltage [s]; `time_constant_s` at 60 V."""
    return time_constant_s * max(1.0 + swell * (voltage_V - ABOUT_V) / PER_V, LEAST)


@numba.njit(cache=True, nogil=True)
def swelling_run(x: Array, time_constant_s: float, swell: float, dt_s: float, hold: float = 0.0) -> Array:
    """`first_order_run` with the time constant of `time_constant_at`, as it stands at each sample's start."""
    out = np.empty(x.size)
    y = x[0]
    out[0] = y
    for k in range(1, x.size):
        keep, ramp = first_order_coefficients(time_constant_at(y, time_constant_s, swell), dt_s, hold)
        y = first_order_step(y, x[k - 1], x[k], keep, ramp)
        out[k] = y
    return out


@numba.njit(cache=True, nogil=True, fastmath={"reassoc"})
def weighted_sum(weights: Array, states: Array) -> float:
    """Sum of products, in any order: several at a time."""
    total = 0.0
    for j in range(states.size):
        total += weights[j] * states[j]
    return total


@numba.njit(cache=True, nogil=True, inline="always")
def chain_step(states: Array, keep: Array, ramp: Array, weights: Array, before: float, now: float) -> float:
    """`first_order_step` of several states beside each other, in place; their weighted sum."""
    for j in range(states.size):
        states[j] = first_order_step(states[j], before, now, keep[j], ramp[j])
    return weighted_sum(weights, states)


@numba.njit(cache=True, nogil=True)
def chain_run(x: Array, time_constants_s: Array, weights: Array, dt_s: float, hold: float = 0.0) -> Array:
    """`chain_step` over a record, counted from rest at its first sample."""
    count = time_constants_s.size
    keep, ramp, states = np.empty(count), np.empty(count), np.zeros(count)
    for j in range(count):
        keep[j], ramp[j] = first_order_coefficients(time_constants_s[j], dt_s, hold)
    out = np.empty(x.size)
    out[0] = 0.0
    for k in range(1, x.size):
        out[k] = chain_step(states, keep, ramp, weights, x[k - 1] - x[0], x[k] - x[0])
    return out


@numba.njit(cache=True, nogil=True)
def second_order_run(x: Array, matrix: Array, before: Array, now: Array) -> Array:
    """State space of two states over a record, from rest: s <- M s + before x(k-1) + now x(k); the output is s[0]."""
    out = np.empty(x.size)
    s0, s1 = x[0], 0.0
    out[0] = s0
    for k in range(1, x.size):
        t0 = matrix[0, 0] * s0 + matrix[0, 1] * s1 + before[0] * x[k - 1] + now[0] * x[k]
        s1 = matrix[1, 0] * s0 + matrix[1, 1] * s1 + before[1] * x[k - 1] + now[1] * x[k]
        s0 = t0
        out[k] = s0
    return out


def second_order(x: Array, frequency_Hz: float, damping_ratio: float, dt_s: float, hold: float = 0.0) -> Array:
    """Mode over a record, from rest, as `second_order_matrices` has it."""
    return second_order_run(np.ascontiguousarray(x), *second_order_matrices(frequency_Hz, damping_ratio, dt_s, hold))


def second_order_matrices(
    frequency_Hz: float, damping_ratio: float, dt_s: float, hold: float = 0.0
) -> tuple[Array, Array, Array]:
    """M, before and now of `second_order_run`, exact for a straight or held input: y'' + 2 zeta w y' + w^2 y = w^2 x.

    The exponential of the state space with the input and its slope as further states (derived here).
    """
    w = 2.0 * math.pi * frequency_Hz
    system = np.zeros((4, 4))  # y, y' / w, x, slope of x
    system[0, 1] = w
    system[1, :3] = -w, -2.0 * damping_ratio * w, w
    system[2, 3] = 1.0
    step = exponential(system * dt_s)
    all_of_it = step[:2, 2].copy()
    now = step[:2, 3] / dt_s if hold <= 0.0 else exponential(system * (dt_s * min(hold, 1.0)))[:2, 2].copy()
    return step[:2, :2].copy(), all_of_it - now, now


def exponential(matrix: Array) -> Array:
    """Exponential of a small matrix, to rounding: a Taylor series of the matrix halved, then squared as often."""
    halvings = max(0, math.ceil(math.log2(np.abs(matrix).sum(axis=1).max() + 1e-300)) + 3)
    small = matrix / 2.0**halvings
    result = term = np.eye(matrix.shape[0])
    for k in range(1, 15):
        term = term @ small / k
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result


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
    """Bouc's and Wen's state over a record, from 0 at the beginning of what led to it.

        dz/ds = 1 - |z|^n                    while |z| grows
        dz/ds = 1 - (1 - 2 closing) |z|^n    while it falls, s = |way| / scale

    Along one direction z is a fixed function of s, which is tabled: a sample moves s on, a reversal mirrors z, and
    neither rate nor sampling matters. closing = 1 and n = 1 is Dahl's solid friction; closing = 0.5 and a large n
    yields like a spring up to its limit, then slides.

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
        The travel or the exponent is not above 0, or the closing not in its range.
    """
    if not (travel > 0.0 and exponent > 0.0 and 0.2 <= closing <= 1.0):
        raise ValueError("travel and exponent must be above 0, closing within 0.2 to 1")
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
