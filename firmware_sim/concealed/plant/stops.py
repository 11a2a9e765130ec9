"""Sums of stop operators: hard stops, and smooth Bouc-Wen stops in closed form.

A hard stop is the input less a play: `s <- clip(s + du, -r, r)`. A smooth stop follows the Bouc-Wen equation with equal
constants for loading and unloading (Wen 1976, Method for random vibration of hysteretic systems):

    dz/du = 1 - |z / r|^n  while |z| grows,    dz/du = 1  while |z| shrinks.

Its loading branch is the master curve `X(z/r) = int dz / (1 - z^n)`. The curve is tabulated, so that a step of any size
is exact. The output of the hysteresis is the input less the weighted stops.

With rate dependence, every width is multiplied by a factor at every sample. A deflection beyond a width that has shrunk
decays along the path travelled and never at rest, or goes at once (`yields_at_rest`).
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

MASTER_POINTS = 16_384
LARGEST_SIZE = 1.0 - 1e-9  # largest tabulated z/r of a smooth stop


@dataclass(frozen=True)
class Stops:
    """Weighted sum of stop operators.

    Parameters
    ----------
    widths_V, weights
        Width r [V] and weight (1) of each stop, shapes (k,).
    exponent
        Exponent n of smooth stops; 0: hard stops.
    """

    widths_V: Array
    weights: Array
    exponent: float

    def run(
        self, voltage_V: Array, widening: Array | None = None, path_V: float = 1.0, *, yields_at_rest: bool = False
    ) -> Array:
        """Weighted sum of the stops from the unloaded state [V].

        Parameters
        ----------
        voltage_V
            Input, shape (n,) [V].
        widening
            Factor on every width, shape (n,) (1); None: 1.
        path_V
            Travel over which a deflection beyond a hard stop decays to 1/e [V].
        yields_at_rest
            Whether a deflection beyond a width that has shrunk goes at once, at rest too.
        """
        factor = np.ones(1) if widening is None else widening
        hard = self.exponent == 0.0
        size, travel = (np.zeros(1), np.zeros(1)) if hard else master_curve(self.exponent)
        result: Array = _run(
            self.widths_V, self.weights, size, travel, voltage_V, factor, path_V, (hard, yields_at_rest)
        )
        return result


def master_curve(exponent: float) -> tuple[Array, Array]:
    """Master curve: relative deflections z/r, and the relative travel that reaches each of them.

    Parameters
    ----------
    exponent
        Exponent of the smooth stop [1], above 0.

    Returns
    -------
    Deflections and travels [1], both of shape (MASTER_POINTS,).
    """
    part = np.linspace(0.0, 1.0, MASTER_POINTS)
    size = LARGEST_SIZE * (1.0 - (1.0 - part) ** 3)
    slope = 1.0 / (1.0 - size**exponent)
    travel = np.concatenate(([0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(size))))
    return size, travel


@njit(cache=True)
def _run(
    widths: Array,
    weights: Array,
    size: Array,
    travel: Array,
    u: Array,
    factor: Array,
    path: float,
    kind: tuple[bool, bool],
) -> Array:
    """Weighted sum of the stops over an input; `factor` of shape (1,) means no widening."""
    stop, out = np.zeros(widths.size), np.empty(u.size)
    hard, at_rest = kind
    last, total = 0.0, 0.0
    for k in range(u.size):
        du = u[k] - last
        last = u[k]
        if du != 0.0:
            wide = factor[k] if factor.size > 1 else 1.0
            keep = np.exp(-abs(du) / path) if factor.size > 1 else 0.0
            total = 0.0
            for i in range(widths.size):
                r = widths[i] * wide
                stop[i] = _move_hard(stop[i], du, r, keep) if hard else _move_smooth(stop[i], du, r, size, travel)
                total += weights[i] * stop[i]
        if at_rest:
            total = 0.0
            for i in range(widths.size):
                r = widths[i] * (factor[k] if factor.size > 1 else 1.0)
                stop[i] = min(max(stop[i], -r), r)
                total += weights[i] * stop[i]
        out[k] = total
    return out


@njit(cache=True)
def _move_hard(z: float, du: float, r: float, keep: float) -> float:
    """Move one hard stop; of a deflection beyond the limit r, the share `keep` remains."""
    moved: float = z + du
    if du > 0.0 and moved > r:
        moved = r + keep * max(z - r, 0.0)
    elif du < 0.0 and moved < -r:
        moved = -r - keep * max(-z - r, 0.0)
    return moved


@njit(cache=True)
def _move_smooth(z: float, du: float, r: float, size: Array, travel: Array) -> float:
    """Move one smooth stop: it unloads along a straight line to zero and loads along the master curve."""
    way = 1.0 if du > 0.0 else -1.0
    left = abs(du)
    x = way * z
    if x < 0.0:
        straight = min(left, -x)
        x += straight
        left -= straight
        if left <= 0.0:
            return way * x
    top = size[-1]
    if x >= top * r:
        # The width has shrunk below the deflection: the excess decays to 1/e over half a width of travel.
        result: float = way * (top * r + (x - top * r) * np.exp(-2.0 * left / r))
        return result
    end = np.interp(x / r, size, travel) + left / r
    return way * r * np.interp(end, travel, size)
