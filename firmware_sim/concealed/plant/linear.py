"""Linear systems answered exactly: the input is a staircase or runs straight between the points of the grid.

`dx/dt = A x + B u, y = C x + D u`. An input and its slope that stay constant over a step are two more states, so the
exponential of the block matrix `[[A, B, 0], [0, 0, 1], [0, 0, 0]] dt` holds the answer to the present state, to a
constant input and to a ramp (derived here).
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

TERMS = 18  # of the exponential's series, once its argument is below 1/2


@dataclass(frozen=True)
class System:
    """A linear system with one input and one output.

    Parameters
    ----------
    A, B, C
        Shapes (n, n), (n,), (n,) [1/s and what follows].
    D
        Direct path (1).
    """

    A: Array
    B: Array
    C: Array
    D: float = 0.0


def first_order(time_constant_s: float) -> System:
    """Low-pass `tau dy/dt = u - y`."""
    rate = np.array([1.0 / time_constant_s])
    return System(-rate[:, None], rate, np.ones(1))


def second_order(frequency_Hz: float, damping_ratio: float) -> System:
    """Low-pass `y'' + 2 d w y' + w^2 y = w^2 u`, gain 1 at rest."""
    w = 2.0 * math.pi * frequency_Hz
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * damping_ratio * w]])
    return System(A, np.array([0.0, w * w]), np.array([1.0, 0.0]))


def high_pass(time_constant_s: float) -> System:
    """What a first-order low-pass leaves over."""
    low = first_order(time_constant_s)
    return System(low.A, low.B, -low.C, 1.0)


def cascade(first: System, second: System) -> System:
    """Two low-passes, one behind the other."""
    n, m = first.B.size, second.B.size
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:] = first.A, second.A
    A[n:, :n] = np.outer(second.B, first.C)
    return System(A, np.concatenate((first.B, np.zeros(m))), np.concatenate((np.zeros(n), second.C)))


def exponential(matrix: Array) -> Array:
    """Exponential of a small matrix by scaling, series and squaring."""
    norm = float(np.abs(matrix).sum(axis=1).max())
    halvings = max(0, math.ceil(math.log2(2.0 * norm))) if norm > 0.0 else 0
    small = matrix / 2.0**halvings
    term = np.eye(matrix.shape[0])
    total = term.copy()
    for k in range(1, TERMS):
        term = term @ small / k
        total += term
    for _ in range(halvings):
        total = total @ total
    return total


def respond(system: System, values: Array, dt_s: float, *, stairs: bool) -> Array:
    """Response to an input that was at `values[0]` for ever before.

    Parameters
    ----------
    system
        Stable.
    values
        Input on the grid, shape (n,).
    dt_s
        Step of the grid [s].
    stairs
        The input keeps its value until the next point; otherwise it runs straight.
    """
    n = system.B.size
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = system.A * dt_s, system.B * dt_s, 1.0
    step = exponential(block)
    ramp = np.zeros(n) if stairs else np.ascontiguousarray(step[:n, n + 1])
    start = np.linalg.solve(system.A, -system.B * values[0])
    phi, constant = np.ascontiguousarray(step[:n, :n]), np.ascontiguousarray(step[:n, n])
    result: Array = _march(phi, constant, ramp, system.C, system.D, values, start)
    return result


@njit(cache=True)
def _march(phi: Array, constant: Array, ramp: Array, C: Array, D: float, values: Array, start: Array) -> Array:
    n = start.size
    x, fresh = start.copy(), np.empty(n)
    y = np.empty(values.size)
    for k in range(values.size):
        total = D * values[k]
        for i in range(n):
            total += C[i] * x[i]
        y[k] = total
        if k + 1 == values.size:
            break
        rise = values[k + 1] - values[k]
        for i in range(n):
            fresh[i] = constant[i] * values[k] + ramp[i] * rise
            for m in range(n):
                fresh[i] += phi[i, m] * x[m]
        for i in range(n):
            x[i] = fresh[i]
    return y
