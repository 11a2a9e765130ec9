"""Coordinates of the drive: direction, rate, distance from the last reversal, and low-passes of the past."""

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array

Places = NDArray[np.int64]

LARGEST_DEAD_BAND = 0.002  # upper limit of the dead band for reversals, relative to the range of the command


def dead_band(u: Array) -> float:
    """Distance that a command must go back to have reversed [unit of u]: above its noise, 0 without noise."""
    if u.size < 3:
        return 0.0
    return min(4.0 * float(np.median(np.abs(np.diff(u, 2)))), LARGEST_DEAD_BAND * float(np.ptp(u)))


def reversals(u: Array) -> tuple[Array, Array]:
    """Direction of a command, +1 or -1, and its distance from the last reversal [unit of u], shape (N,) each."""
    direction, distance = np.empty(u.size), np.empty(u.size)
    _reversals(np.ascontiguousarray(u), dead_band(u), direction, distance)
    return direction, distance


@numba.njit(cache=True)
def _reversals(u: Array, least: float, direction: Array, distance: Array) -> None:
    way, turned, extreme = 1.0, u[0], u[0]
    for k in range(u.size):
        beyond = way * (u[k] - extreme)
        if beyond >= 0.0:
            extreme = u[k]
        elif -beyond > least:
            way, turned, extreme = -way, extreme, u[k]
        direction[k] = way
        distance[k] = abs(u[k] - turned)


def rate(u: Array, dt_s: float) -> Array:
    """du/dt by central differences, shape (N,)."""
    result: Array = np.gradient(u, dt_s)
    return result


def times(dt_s: float, duration_s: float, count: int, shortest: float = 1.0, longest: float = 0.25) -> Array:
    """Log-spaced times from `shortest` samples to the share `longest` of the duration, shape (count,) [s]."""
    low = shortest * dt_s
    return np.geomspace(low, max(longest * duration_s, 2.0 * low), count)


def decay_factors(dt_s: float, times_s: Array) -> Array:
    """Decay of first-order low-passes in one sample, exp(-dt / tau), shape of `times_s` [1]."""
    result: Array = np.exp(-dt_s / times_s)
    return result


@numba.njit(cache=True)
def low_pass(x: Array, decays: Array, state: Array, out: Array) -> None:
    """First-order low-passes of one input.

    Parameters
    ----------
    x
        Input, shape (N,).
    decays
        exp(-dt / tau), shape (K,).
    state
        State before the first sample, replaced by that after the last, shape (K,).
    out
        Output, shape (N, K).
    """
    for k in range(x.size):
        for j in range(decays.size):
            state[j] = x[k] + decays[j] * (state[j] - x[k])
            out[k, j] = state[j]


def low_passed(x: Array, dt_s: float, times_s: Array) -> Array:
    """First-order low-passes of an input that rested at its first value, shape (N, K)."""
    out = np.empty((x.size, times_s.size))
    low_pass(np.ascontiguousarray(x), decay_factors(dt_s, times_s), np.full(times_s.size, x[0]), out)
    return out


def quantile_edges(values: Array, cells: int, also: tuple[float, ...] = ()) -> Array:
    """Edges of cells with about equally many values, shape (C + 1,), C <= cells; further edges at quantiles `also`."""
    edges = np.unique(np.quantile(values, np.append(np.linspace(0.0, 1.0, cells + 1), also)))
    return edges if edges.size > 1 else np.array([edges[0], edges[0]])


def cell_of(values: Array, edges: Array) -> Places:
    """Index of the cell of each value, shape of `values`."""
    result: Places = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(edges.size - 2, 0))
    return result
