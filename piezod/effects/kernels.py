"""Steps of linear systems, exact for an input that runs straight between two samples; compiled once.

A compiled step calls steps of its own file only: numba compares its cache with no other.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@numba.njit(cache=True, nogil=True)
def first_order_step(y: float, before: float, now: float, keep: float, ramp: float) -> float:
    """Advance tau y' = x - y by a sample while x runs straight from `before` to `now`.

    With a = exp(-T / tau) = `keep` and b = 1 - tau (1 - a) / T = `ramp`: y <- a y + (1 - a - b) before + b now, written
    so that a resting state rests to the last digit.
    """
    return y + (1.0 - keep) * (before - y) + ramp * (now - before)


@numba.njit(cache=True, nogil=True)
def first_order_coefficients(time_constant_s: float, dt_s: float, between: float = 0.0) -> tuple[float, float]:
    """`keep` and `ramp` of `first_order_step`; of a held input `ramp` is what its last part of a sample adds."""
    part = dt_s / time_constant_s
    keep = math.exp(-part)
    if between > 0.0:
        return keep, -math.expm1(-part * min(between, 1.0))
    ramp = 1.0 + math.expm1(-part) / part if part > 1e-6 else 0.5 * part
    return keep, ramp


@numba.njit(cache=True, nogil=True)
def first_order_run(x: Array, time_constant_s: float, dt_s: float, between: float = 0.0) -> Array:
    """`first_order_step` over a record, from rest at its first sample; `between` as in `Context`."""
    keep, ramp = first_order_coefficients(time_constant_s, dt_s, between)
    out = np.empty(x.size)
    y = x[0]
    out[0] = y
    for k in range(1, x.size):
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
def chain_run(x: Array, time_constants_s: Array, weights: Array, dt_s: float, between: float = 0.0) -> Array:
    """`chain_step` over a record, counted from rest at its first sample."""
    count = time_constants_s.size
    keep, ramp, states = np.empty(count), np.empty(count), np.zeros(count)
    for j in range(count):
        keep[j], ramp[j] = first_order_coefficients(time_constants_s[j], dt_s, between)
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


def second_order(x: Array, frequency_Hz: float, damping_ratio: float, dt_s: float, between: float = 0.0) -> Array:
    """Mode over a record, from rest, as `second_order_matrices` has it."""
    return second_order_run(np.ascontiguousarray(x), *second_order_matrices(frequency_Hz, damping_ratio, dt_s, between))


def second_order_matrices(
    frequency_Hz: float, damping_ratio: float, dt_s: float, between: float = 0.0
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
    now = step[:2, 3] / dt_s if between <= 0.0 else exponential(system * (dt_s * min(between, 1.0)))[:2, 2].copy()
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
