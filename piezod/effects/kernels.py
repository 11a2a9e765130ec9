"""Compiled functions that several effects share: linear systems, and the Bouc-Wen hysteresis.

The linear systems are exact for an input that runs straight between samples, and for a held input. Parameters of all:
`x` is the input, shape (N,), as is the output; `dt_s` is the sample period [s], above 0; `hold` is the number of a
`Hold`. A compiled function calls functions of its own file only: numba compares its cache with no other file.
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.tick import Memory

NODES, FARTHEST = 1024, 24.0  # size of the Bouc-Wen table, and its last distance: the state is constant beyond
SWELL_AT_V, SWELL_PER_V = 60.0, 100.0  # voltage at which a time constant is given, and the change that swell refers to
LEAST_PART = 0.2  # smallest time constant at any voltage, as a part of the given one
RISEN = 1.0 - math.exp(-1.0)  # state after a movement by `travel` from 0


@numba.njit(cache=True, nogil=True)
def first_order_step(y: float, before: float, now: float, keep: float, ramp: float) -> float:
    """State of tau y' = x - y one sample later, when x runs straight from `before` to `now`.

    y <- a y + (1 - a - b) before + b now (derived here). `y`, `before` and `now` have one unit.
    a = exp(-T / tau) is `keep`. b = 1 - tau (1 - a) / T is `ramp`. In the form below rounding moves no state at rest.
    """
    return y + (1.0 - keep) * (before - y) + ramp * (now - before)


@numba.njit(cache=True, nogil=True)
def first_order_coefficients(time_constant_s: float, dt_s: float, hold: float = 0.0) -> tuple[float, float]:
    """`keep` and `ramp` of `first_order_step`; for a held input `ramp` is the response to the new value.

    Parameters
    ----------
    time_constant_s
        tau [s], above 0.
    dt_s
        Spacing of the samples T [s].
    hold
        Number of a `Hold`.
    """
    part = dt_s / time_constant_s
    keep = math.exp(-part)
    if hold > 0.0:
        return keep, -math.expm1(-part * min(hold, 1.0))
    ramp = 1.0 + math.expm1(-part) / part if part > 1e-6 else 0.5 * part
    return keep, ramp


@numba.njit(cache=True, nogil=True)
def first_order_run(x: Array, time_constant_s: float, dt_s: float, hold: float = 0.0) -> Array:
    """`first_order_step` over `x`, shape (N,), from rest; time constant and period dt_s [s], both above 0."""
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
    """Time constant of a lag into a capacitance that grows with the voltage [s].

    Parameters
    ----------
    voltage_V
        Voltage at the capacitance [V].
    time_constant_s
        Time constant at 60 V [s].
    swell
        Relative change of the time constant per 100 V [1].
    """
    return time_constant_s * max(1.0 + swell * (voltage_V - SWELL_AT_V) / SWELL_PER_V, LEAST_PART)


@numba.njit(cache=True, nogil=True)
def voltage_dependent_lag_run(x: Array, time_constant_s: float, swell: float, dt_s: float, hold: float = 0.0) -> Array:
    """`first_order_run` for a voltage x [V]; `time_constant_at` gives the time constant at the start of each sample."""
    out = np.empty(x.size)
    y = x[0]
    out[0] = y
    for k in range(1, x.size):
        keep, ramp = first_order_coefficients(time_constant_at(y, time_constant_s, swell), dt_s, hold)
        y = first_order_step(y, x[k - 1], x[k], keep, ramp)
        out[k] = y
    return out


@numba.njit(cache=True, nogil=True, fastmath={"reassoc"})
def _weighted_sum(weights: Array, states: Array) -> float:
    """Sum of weights * states, both of shape (n,); the order of the sum is free, for vector instructions."""
    total = 0.0
    for j in range(states.size):
        total += weights[j] * states[j]
    return total


@numba.njit(cache=True, nogil=True, inline="always")
def _chain_step(states: Array, keep: Array, ramp: Array, weights: Array, before: float, now: float) -> float:
    """`first_order_step` of parallel states, in place; returns their weighted sum; all arrays are of shape (n,)."""
    for j in range(states.size):
        states[j] = first_order_step(states[j], before, now, keep[j], ramp[j])
    return _weighted_sum(weights, states)


@numba.njit(cache=True, nogil=True)
def chain_run(x: Array, time_constants_s: Array, weights: Array, dt_s: float, hold: float = 0.0) -> Array:
    """`_chain_step` over `x`, shape (N,), less its first value; time constants [s] and weights of shape (n,)."""
    count = time_constants_s.size
    keep, ramp, states = np.empty(count), np.empty(count), np.zeros(count)
    for j in range(count):
        keep[j], ramp[j] = first_order_coefficients(time_constants_s[j], dt_s, hold)
    out = np.empty(x.size)
    out[0] = 0.0
    for k in range(1, x.size):
        out[k] = _chain_step(states, keep, ramp, weights, x[k - 1] - x[0], x[k] - x[0])
    return out


@numba.njit(cache=True, nogil=True)
def _second_order_run(x: Array, matrix: Array, before: Array, now: Array) -> Array:
    """State space from rest, `matrix` of shape (2, 2): s <- M s + before x(k-1) + now x(k); output s[0], shape (N,)."""
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
    """System of `second_order_matrices` over the record `x`, shape (N,), from rest; returns shape (N,)."""
    return _second_order_run(np.ascontiguousarray(x), *second_order_matrices(frequency_Hz, damping_ratio, dt_s, hold))


def second_order_matrices(
    frequency_Hz: float, damping_ratio: float, dt_s: float, hold: float = 0.0
) -> tuple[Array, Array, Array]:
    """M, shape (2, 2), `before` and `now`, shape (2,), of `_second_order_run`.

    The system is y'' + 2 zeta w y' + w^2 y = w^2 x, w = 2 pi frequency_Hz; the frequency [Hz] is above 0.
    They are blocks of the matrix exponential of the state space with the input and its slope as further states.
    Source: C. F. Van Loan (1978), Computing Integrals Involving the Matrix Exponential, IEEE Transactions on Automatic
    Control 23(3), 395-404.
    """
    w = 2.0 * math.pi * frequency_Hz
    system = np.zeros((4, 4))  # y, y' / w, x, slope of x
    system[0, 1] = w
    system[1, :3] = -w, -2.0 * damping_ratio * w, w
    system[2, 3] = 1.0
    step = _exponential(system * dt_s)
    step_response = step[:2, 2].copy()
    now = step[:2, 3] / dt_s if hold <= 0.0 else _exponential(system * (dt_s * min(hold, 1.0)))[:2, 2].copy()
    return step[:2, :2].copy(), step_response - now, now


def second_order_memory(frequency_Hz: float, damping_ratio: float, dt_s: float, hold: float) -> Array:
    """Memory of `second_order_step`: `second_order_matrices` (8 numbers), input and the two states, shape (11,)."""
    rows = second_order_matrices(frequency_Hz, damping_ratio, dt_s, hold)
    return np.concatenate([*(np.ravel(row) for row in rows), np.zeros(3)])


@numba.njit(cache=True, nogil=True)
def second_order_step(own: Memory, first: int, x: float) -> float:
    """First state after a tick with the input `x`; `own` holds the memory of the system from `first` on."""
    y, rate, before = own[first + 9], own[first + 10], own[first + 8]
    own[first + 9] = own[first] * y + own[first + 1] * rate + own[first + 4] * before + own[first + 6] * x
    own[first + 10] = own[first + 2] * y + own[first + 3] * rate + own[first + 5] * before + own[first + 7] * x
    own[first + 8] = x
    return own[first + 9]


@numba.njit(cache=True, nogil=True)
def second_order_settle(own: Memory, first: int, x: float) -> float:
    """Set the system of `second_order_step` to rest at the input `x`."""
    own[first + 8] = own[first + 9] = x
    own[first + 10] = 0.0
    return x


def _exponential(matrix: Array) -> Array:
    """Exponential of a small square matrix: Taylor series of the matrix halved n times, then squared n times."""
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
    """dz/ds of a rising state z."""
    rate: float = 1.0 - abs(z) ** exponent * (1.0 if z > 0.0 else 1.0 - 2.0 * closing)
    return rate


@numba.njit(cache=True, nogil=True)
def _runge_kutta(z: float, step: float, exponent: float, closing: float) -> float:
    """State after the distance `step`, by one Runge-Kutta step of fourth order."""
    a = _rate(z, exponent, closing)
    b = _rate(z + 0.5 * step * a, exponent, closing)
    c = _rate(z + 0.5 * step * b, exponent, closing)
    d = _rate(z + step * c, exponent, closing)
    return z + step * (a + 2.0 * b + 2.0 * c + d) / 6.0


@numba.njit(cache=True, nogil=True)
def _table(exponent: float, closing: float) -> tuple[Array, Array, float, float]:
    """States and slopes at equal steps of s from z = -1, the step, and the s at which z is 0."""
    below = 0.0
    z, step = 0.0, FARTHEST / NODES
    while z > -1.0:
        z = _runge_kutta(z, -step, exponent, closing)
        below += step
    size = NODES + round(below / step)
    states, slopes = np.empty(size), np.empty(size)
    middle = size - NODES
    states[middle] = 0.0
    for k in range(middle + 1, size):
        states[k] = min(_runge_kutta(states[k - 1], step, exponent, closing), 1.0)
    for k in range(middle - 1, -1, -1):
        states[k] = _runge_kutta(states[k + 1], -step, exponent, closing)
    for k in range(size):
        slopes[k] = max(_rate(states[k], exponent, closing), 0.0)
    return states, slopes, step, middle * step


@numba.njit(cache=True, nogil=True)
def _state_at(s: float, states: Array, slopes: Array, step: float) -> float:
    """State at the distance `s`, by cubic Hermite interpolation of the table."""
    k = min(int(s / step), states.size - 2)
    t = min(s / step - k, 1.0)
    rise = states[k + 1] - states[k]
    first, last = step * slopes[k] - rise, rise - step * slopes[k + 1]
    z: float = states[k] + t * (rise + (1.0 - t) * (first * (1.0 - t) + last * t))
    return z


@numba.njit(cache=True, nogil=True)
def _distance_to(z: float, states: Array, slopes: Array, step: float) -> float:
    """Distance at which the state is `z`, by bisection."""
    k = min(max(int(np.searchsorted(states, z)), 1), states.size - 1) - 1
    low, high = k * step, (k + 1) * step
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _state_at(middle, states, slopes, step) < z:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@numba.njit(cache=True, nogil=True)
def bouc_wen(path: Array, x: Array, travel: float, exponent: float, closing: float) -> Array:
    """State z of the Bouc-Wen hysteresis over a record, from z = 0 at the first value of `path`.

        dz/ds = 1 - |z|^n                    while |z| grows,
        dz/ds = 1 - (1 - 2 closing) |z|^n    while |z| falls;   s = distance moved / scale

    In one direction z is a fixed function of s, which is tabulated. A sample advances s, a reversal mirrors z. The
    result depends neither on the rate nor on the sampling.

    closing = 1 and n = 1 is Dahl's solid friction. closing = 0.5 and a large n is a spring that yields at its limit.

    Parameters
    ----------
    path
        Input values before the first sample, shape (P,); empty: the state is 0 at the first sample.
    x
        Input, shape (N,).
    travel
        Distance in which z rises from 0 to 63 % [unit of x], above 0.
    exponent, closing
        n, above 0, and the shape of the return, 0.2 to 1 [1].

    Returns
    -------
    ndarray
        States, -1 to 1, shape (N,).

    Raises
    ------
    ValueError
        `travel` or `exponent` is not above 0, or `closing` is outside 0.2 to 1.

    Notes
    -----
    Source: M. Ismail, F. Ikhouane and J. Rodellar (2009), The Hysteresis Bouc-Wen Model, a Survey,
    doi:10.1007/s11831-009-9031-8; the table: derived here.
    """
    if not (travel > 0.0 and exponent > 0.0 and 0.2 <= closing <= 1.0):
        raise ValueError("bouc_wen: travel and exponent must be above 0, closing must be within 0.2 and 1")
    states, slopes, step, begin = _table(exponent, closing)
    scale = travel / (_distance_to(RISEN, states, slopes, step) - begin)
    out = np.empty(x.size)
    before = path[0] if path.size else x[0]
    z, s, sign = 0.0, begin, 1.0
    for k in range(path.size + x.size):
        now = path[k] if k < path.size else x[k - path.size]
        moved = (now - before) / scale
        if moved != 0.0:
            if moved * sign < 0.0:
                sign = -sign
                s = _distance_to(-z, states, slopes, step)
            s += abs(moved)
            z = _state_at(s, states, slopes, step)
            before = now
        if k >= path.size:
            out[k - path.size] = sign * z
    return out
