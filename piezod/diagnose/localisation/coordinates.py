"""What a residual may depend on: direction, rate, way since the last reversal, and what fades of the past."""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Places = NDArray[np.int64]

SMALLEST_REVERSAL = 0.002  # of the command's range: a read-back's noise does not reverse it


def smallest_reversal(u: Array) -> float:
    """How far the command must go back to have reversed, in its unit: its own noise, 0 for a command without."""
    if u.size < 3:
        return 0.0
    return min(4.0 * float(np.median(np.abs(np.diff(u, 2)))), SMALLEST_REVERSAL * float(np.ptp(u)))


def reversals(u: Array) -> tuple[Array, Array]:
    """Direction of the last move and distance from the last reversal.

    Parameters
    ----------
    u
        Command, shape (N,).

    Returns
    -------
    direction, distance
        +1 or -1, and in the command's unit, each shape (N,).
    """
    direction, distance = np.empty(u.size), np.empty(u.size)
    _reversals(np.ascontiguousarray(u), smallest_reversal(u), direction, distance)
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
    """Log-spaced times from so many samples up to a part of the duration, shape (count,) [s]."""
    low = shortest * dt_s
    return np.geomspace(low, max(longest * duration_s, 2.0 * low), count)


def fading(dt_s: float, times_s: Array) -> Array:
    """By how much the past fades in one sample, exp(-dt / tau), shape of `times_s` [1]."""
    result: Array = np.exp(-dt_s / times_s)
    return result


@numba.njit(cache=True)
def faded(x: Array, keep: Array, state: Array, out: Array) -> None:
    """First-order low-passes side by side, from a state that is moved on.

    Parameters
    ----------
    x
        Input, shape (N,).
    keep
        exp(-dt / tau), shape (K,).
    state
        Shape (K,); at the end that of the last sample.
    out
        Shape (N, K), written.
    """
    for k in range(x.size):
        for j in range(keep.size):
            state[j] = x[k] + keep[j] * (state[j] - x[k])
            out[k, j] = state[j]


def faded_columns(x: Array, dt_s: float, times_s: Array) -> Array:
    """The same at once, from rest at the first value, shape (N, K)."""
    out = np.empty((x.size, times_s.size))
    faded(np.ascontiguousarray(x), fading(dt_s, times_s), np.full(times_s.size, x[0]), out)
    return out


def quantile_edges(values: Array, cells: int, also: tuple[float, ...] = ()) -> Array:
    """Edges of cells that hold about as many values each, shape (C + 1,), C <= cells; equal edges fall together.

    `also` are quantiles at which there are edges too.
    """
    edges = np.unique(np.quantile(values, np.append(np.linspace(0.0, 1.0, cells + 1), also)))
    return edges if edges.size > 1 else np.array([edges[0], edges[0]])


def cell_of(values: Array, edges: Array) -> Places:
    """Index of each value's cell, shape of `values`."""
    result: Places = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(edges.size - 2, 0))
    return result
