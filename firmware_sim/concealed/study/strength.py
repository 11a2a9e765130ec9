"""Strength of an effect on a recording, and the parameter value that gives a target strength."""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.linear import first_order, respond

PLAYS = 30  # play operators that a refit superposes
NEIGHBOUR_SAMPLES, NEIGHBOUR_TIMES = 3.0, 12
MOST_ROWS = 6000  # samples of a refit
TOLERANCE = 0.08  # of ln(strength / target)
MOST_TRIALS = 9
SMALLEST = 1e-13  # least eigenvalue of a direction, relative to the largest


class VisibleDifference:
    """Measures the change of the reading by an effect, less the part that a refitted model absorbs.

    Parameters
    ----------
    without
        Reading without the effect, shape (n,) [N].
    voltage_V
        Commands, shape (n,) [V].
    rate_Hz
        Rate of the readings [1/s].
    """

    def __init__(self, without: Array, voltage_V: Array, rate_Hz: float) -> None:
        self._every = max(1, math.ceil(without.size / MOST_ROWS))
        widths = voltage_V.max() * np.linspace(0.0, 1.0, PLAYS) ** 1.3
        rows = play_columns(widths, voltage_V)[:: self._every]
        thin = without[:: self._every, None]
        self._fixed = _orthonormal_basis(np.column_stack((without, np.ones(without.size))))
        columns = np.hstack((rows, np.ones((rows.shape[0], 1)), thin))
        self._refitted = _orthonormal_basis(columns)
        self._without, self._rate_Hz, self._columns = without, rate_Hz, columns

    def after_gain_and_offset_N(self, with_effect: Array) -> float:
        """Rms residual after a refit of gain and offset [N]: the error of a fixed model."""
        return _rms_residual(self._fixed, with_effect)

    def after_refit_N(self, with_effect: Array) -> float:
        """Rms residual after a refit of gain, offset and superposed plays [N].

        It is the error of a model that was identified with the effect already present.
        """
        return _rms_residual(self._refitted, with_effect[:: self._every])

    def after_neighbours_N(self, with_effect: Array) -> float:
        """Rms residual after a refit that also includes first-order signatures of catalogue effects [N].

        It is the part of a foreign effect that the catalogue cannot reproduce.
        """
        return _rms_residual(self._neighboured, with_effect[:: self._every])

    @cached_property
    def _neighboured(self) -> Array:
        signatures = neighbours(self._without, self._rate_Hz)[:: self._every]
        return _orthonormal_basis(np.hstack((self._columns, signatures)))


def neighbours(force_N: Array, rate_Hz: float) -> Array:
    """First-order signatures of catalogue effects on a force, shape (n, k).

    - slope: delay, lag, feedthrough;
    - slope times time: clock skew;
    - low-passes from some samples to minutes: lag, filter, creep, leakage;
    - powers of the force: force law;
    - powers of time, and force times time: drifts.

    Parameters
    ----------
    force_N
        Force, shape (n,) [N].
    rate_Hz
        Sample rate [Hz].
    """
    part = np.linspace(-1.0, 1.0, force_N.size)
    slope = np.gradient(force_N)
    times_s = np.geomspace(NEIGHBOUR_SAMPLES / rate_Hz, force_N.size / rate_Hz, NEIGHBOUR_TIMES)
    passed = [respond(first_order(float(tau_s)), force_N, 1.0 / rate_Hz, held=False) for tau_s in times_s]
    powers = [force_N**2, force_N**3, part, part**2, part**3, force_N * part, force_N * part**2]
    return np.column_stack([slope, slope * part, *passed, *powers])


def find_scale(strength: Callable[[float], float], target: float, low: float, high: float) -> float | None:
    """Value between two bounds at which a monotone function reaches a target.

    Method: regula falsi in the logarithms of value and result; every third trial bisects.

    Parameters
    ----------
    strength
        Monotone function of the value.
    target
        Target of the function, above 0.
    low, high
        Bounds of the value, above 0.

    Returns
    -------
    float or None
        None when the target lies outside of the values at the bounds, or the trials are used up.
    """
    x = [math.log(low), math.log(high)]
    y = [_log_ratio(strength(low), target), _log_ratio(strength(high), target)]
    if y[0] * y[1] > 0.0:
        return None
    for trial in range(MOST_TRIALS):
        part = 0.5 if trial % 3 == 2 else min(max(y[0] / (y[0] - y[1]), 0.05), 0.95)
        middle = x[0] + part * (x[1] - x[0])
        value = _log_ratio(strength(math.exp(middle)), target)
        if abs(value) < TOLERANCE:
            return math.exp(middle)
        side = 0 if value * y[0] > 0.0 else 1
        x[side], y[side] = middle, value
    return None


@njit(cache=True)
def play_columns(widths: Array, u: Array) -> Array:
    """Outputs of play operators over an input from rest, shape (n, k) [V].

    Parameters
    ----------
    widths
        Thresholds, shape (k,) [V], at least 0.
    u
        Input, shape (n,) [V].
    """
    z, out = np.zeros(widths.size), np.empty((u.size, widths.size))
    for k in range(u.size):
        for i in range(widths.size):
            z[i] = max(u[k] - widths[i], min(u[k] + widths[i], z[i]))
            out[k, i] = z[i]
    return out


def _orthonormal_basis(columns: Array) -> Array:
    """Orthonormal basis of the span of columns, shape (n, rank)."""
    columns = columns / np.sqrt((columns**2).sum(axis=0)).clip(1e-300)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    used = values > SMALLEST * values[-1]
    result: Array = columns @ (vectors[:, used] / np.sqrt(values[used]))
    return result


def _rms_residual(directions: Array, values: Array) -> float:
    """Rms of the part of values orthogonal to a basis; projected twice against rounding errors."""
    residual = values - directions @ (directions.T @ values)
    residual -= directions @ (directions.T @ residual)
    return float(np.sqrt(np.mean(residual**2)))


def _log_ratio(value: float, target: float) -> float:
    return math.log(max(value, 1e-9 * target) / target)
