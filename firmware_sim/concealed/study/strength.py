"""How strongly an effect shows on a recording, and the parameter at which it shows as strongly as wanted."""

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.linear import first_order, respond

PLAYS = 30
NEIGHBOUR_SAMPLES, NEIGHBOUR_TIMES = 3.0, 12
MOST_ROWS = 6000
TOLERANCE = 0.08  # of the wanted strength
MOST_TRIALS = 9
SMALLEST = 1e-13  # squared length of a direction that counts, against the longest


class Visible:
    """Measures the difference that an effect makes, after what a refitted model would absorb of it.

    Parameters
    ----------
    without
        Reading of the plant without the effect, shape (n,) [N].
    voltage_V
        Commands, shape (n,) [V].
    rate_Hz
        Readings a second [1/s].
    """

    def __init__(self, without: Array, voltage_V: Array, rate_Hz: float) -> None:
        self._every = max(1, math.ceil(without.size / MOST_ROWS))
        widths = voltage_V.max() * np.linspace(0.0, 1.0, PLAYS) ** 1.3
        rows = play_columns(widths, voltage_V)[:: self._every]
        thin = without[:: self._every, None]
        self._fixed = _directions(np.column_stack((without, np.ones(without.size))))
        columns = np.hstack((rows, np.ones((rows.shape[0], 1)), thin))
        self._refitted = _directions(columns)
        self._without, self._rate_Hz, self._columns = without, rate_Hz, columns

    def after_gain_and_offset_N(self, with_effect: Array) -> float:
        """Rms of the difference after gain and offset are refitted [N]: what a fixed model cannot follow."""
        return _left_over(self._fixed, with_effect)

    def after_refit_N(self, with_effect: Array) -> float:
        """Rms of the difference after superposed plays are refitted as well [N].

        What is left when the model was identified with the effect already there.
        """
        return _left_over(self._refitted, with_effect[:: self._every])

    def after_neighbours_N(self, with_effect: Array) -> float:
        """Rms of the difference after a refit, and after what many effects of the catalogue do to first order [N].

        What is left of an effect in no catalogue when its neighbours have swallowed what they can.
        """
        return _left_over(self._neighboured, with_effect[:: self._every])

    @cached_property
    def _neighboured(self) -> Array:
        signatures = neighbours(self._without, self._rate_Hz)[:: self._every]
        return _directions(np.hstack((self._columns, signatures)))


def neighbours(force_N: Array, rate_Hz: float) -> Array:
    """First-order signatures of effects of the catalogue on a force, shape (n, k).

    Its slope (delay, lag, feedthrough) and that growing with time (clocks), low-passes from some samples to minutes
    (lag, filter, creep, leakage), powers (force law), time and the force that grows with it (drifts).
    """
    part = np.linspace(-1.0, 1.0, force_N.size)
    slope = np.gradient(force_N)
    times_s = np.geomspace(NEIGHBOUR_SAMPLES / rate_Hz, force_N.size / rate_Hz, NEIGHBOUR_TIMES)
    passed = [respond(first_order(float(tau_s)), force_N, 1.0 / rate_Hz, stairs=False) for tau_s in times_s]
    powers = [force_N**2, force_N**3, part, part**2, part**3, force_N * part, force_N * part**2]
    return np.column_stack([slope, slope * part, *passed, *powers])


def find_scale(visible: Callable[[float], float], wanted: float, low: float, high: float) -> float | None:
    """The value between two bounds at which something that grows or falls steadily has the value wanted.

    Regula falsi (Illinois) on logarithms, with the sides bisected when it dawdles.

    Returns
    -------
    float or None
        None when the bounds do not reach it.
    """
    x = [math.log(low), math.log(high)]
    y = [_log_ratio(visible(low), wanted), _log_ratio(visible(high), wanted)]
    if y[0] * y[1] > 0.0:
        return None
    for trial in range(MOST_TRIALS):
        part = 0.5 if trial % 3 == 2 else min(max(y[0] / (y[0] - y[1]), 0.05), 0.95)
        middle = x[0] + part * (x[1] - x[0])
        value = _log_ratio(visible(math.exp(middle)), wanted)
        if abs(value) < TOLERANCE:
            return math.exp(middle)
        side = 0 if value * y[0] > 0.0 else 1
        x[side], y[side] = middle, value
    return None


@njit(cache=True)
def play_columns(widths: Array, u: Array) -> Array:
    """Play operators over an input from rest, shape (n, k)."""
    z, out = np.zeros(widths.size), np.empty((u.size, widths.size))
    for k in range(u.size):
        for i in range(widths.size):
            z[i] = max(u[k] - widths[i], min(u[k] + widths[i], z[i]))
            out[k, i] = z[i]
    return out


def _directions(columns: Array) -> Array:
    """Orthonormal directions that columns of length about 1 span, shape (n, rank)."""
    columns = columns / np.sqrt((columns**2).sum(axis=0)).clip(1e-300)
    values, vectors = np.linalg.eigh(columns.T @ columns)
    kept = values > SMALLEST * values[-1]
    result: Array = columns @ (vectors[:, kept] / np.sqrt(values[kept]))
    return result


def _left_over(directions: Array, values: Array) -> float:
    """Rms of what values have outside of the directions; twice removed, so that rounding leaves nothing inside."""
    left = values - directions @ (directions.T @ values)
    left -= directions @ (directions.T @ left)
    return float(np.sqrt(np.mean(left**2)))


def _log_ratio(value: float, wanted: float) -> float:
    return math.log(max(value, 1e-9 * wanted) / wanted)
