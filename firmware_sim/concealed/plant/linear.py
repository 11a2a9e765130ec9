"""Exact response of linear systems to an input that is held, or runs straight, between the points of the grid.

System: `dx/dt = A x + B u, y = C x + D u`. Over one step, the input and its slope are two more states. The exponential
of the block matrix `[[A, B, 0], [0, 0, 1], [0, 0, 0]] dt` then holds three responses: to the state, to a constant input
and to a ramp. Source: Van Loan (1978), Computing integrals involving the matrix exponential,
doi:10.1109/TAC.1978.1101743.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

TERMS = 18  # terms of the series of the exponential, for a norm below 1/2


@dataclass(frozen=True)
class System:
    """A linear system with one input and one output.

    Parameters
    ----------
    A, B, C
        State matrix, input and output vector, shapes (n, n), (n,), (n,); time in [s].
    D
        Direct path from input to output (1).
    """

    A: Array
    B: Array
    C: Array
    D: float = 0.0


def first_order(time_constant_s: float) -> System:
    """Low-pass `tau dy/dt = u - y`.

    Parameters
    ----------
    time_constant_s
        tau [s], above 0.
    """
    rate = np.array([1.0 / time_constant_s])
    return System(-rate[:, None], rate, np.ones(1))


def second_order(frequency_Hz: float, damping_ratio: float) -> System:
    """Low-pass `y'' + 2 d w y' + w^2 y = w^2 u`, gain 1 at rest.

    Parameters
    ----------
    frequency_Hz
        Natural frequency w / (2 pi) [Hz], above 0.
    damping_ratio
        d [1].
    """
    w = 2.0 * math.pi * frequency_Hz
    A = np.array([[0.0, 1.0], [-w * w, -2.0 * damping_ratio * w]])
    return System(A, np.array([0.0, w * w]), np.array([1.0, 0.0]))


def high_pass(time_constant_s: float) -> System:
    """First-order high-pass: the input less its first-order low-pass.

    Parameters
    ----------
    time_constant_s
        Time constant of the low-pass [s], above 0.
    """
    low = first_order(time_constant_s)
    return System(low.A, low.B, -low.C, 1.0)


def cascade(first: System, second: System) -> System:
    """Two low-passes in series.

    Parameters
    ----------
    first, second
        Low-passes without direct feedthrough, of n and m states.

    Returns
    -------
    System of n + m states.
    """
    n, m = first.B.size, second.B.size
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[n:, n:] = first.A, second.A
    A[n:, :n] = np.outer(second.B, first.C)
    return System(A, np.concatenate((first.B, np.zeros(m))), np.concatenate((np.zeros(n), second.C)))


def exponential(matrix: Array) -> Array:
    """Exponential of a small square matrix by scaling, Taylor series and squaring.

    Parameters
    ----------
    matrix
        Square matrix, shape (n, n).

    Returns
    -------
    Shape (n, n).
    """
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


def respond(system: System, values: Array, dt_s: float, *, held: bool) -> Array:
    """Response from the equilibrium at `values[0]`, shape (n,).

    Parameters
    ----------
    system
        Stable linear system.
    values
        Input on the grid, shape (n,).
    dt_s
        Step of the grid [s].
    held
        True: the input is held until the next point. False: it runs straight to the next point.
    """
    n = system.B.size
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = system.A * dt_s, system.B * dt_s, 1.0
    step = exponential(block)
    ramp = np.zeros(n) if held else np.ascontiguousarray(step[:n, n + 1])
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
