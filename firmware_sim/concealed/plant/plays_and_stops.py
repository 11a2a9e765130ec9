"""Superpositions of stops with their loads drawn at random: sharp ones, and smooth Bouc-Wen ones in closed form.

A sharp stop carries what of its input is left over by a play: `s <- clip(s + du, -r, r)`. A smooth one follows
Bouc and Wen with equal constants for loading and unloading,

    dz/du = 1 - |z / r|^n  when z grows in size,    dz/du = 1  when it shrinks,

whose loading branch is one master curve `X(z/r) = int dz / (1 - z^n)`, tabulated: any step is exact. The output is the
input less the weighted stops.

When the rate counts, every width is multiplied by `(1 + rate / reference)^growth`. A width that has become too small is
left along the path travelled, never at rest.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

MASTER_POINTS = 16_384
NEAREST = 1.0 - 1e-9  # of a smooth stop to its width


@dataclass(frozen=True)
class Stops:
    """A superposition.

    Parameters
    ----------
    widths_V, weights
        Of each stop, shapes (k,) [V], (1).
    exponent
        n of the smooth ones; 0: sharp.
    """

    widths_V: Array
    weights: Array
    exponent: float

    def run(self, voltage_V: Array, widening: Array | None = None, path_V: float = 1.0) -> Array:
        """Weighted sum of the stops from the unloaded state [V].

        Parameters
        ----------
        voltage_V
            Input, shape (n,) [V].
        widening
            What the widths are multiplied by, shape (n,); None: 1.
        path_V
            Travel in which a width that has shrunk is left [V].
        """
        factor = np.ones(1) if widening is None else widening
        if self.exponent == 0.0:
            sharp: Array = _run_sharp(self.widths_V, self.weights, voltage_V, factor, path_V)
            return sharp
        size, travel = master_curve(self.exponent)
        smooth: Array = _run_smooth(self.widths_V, self.weights, size, travel, voltage_V, factor)
        return smooth


def master_curve(exponent: float) -> tuple[Array, Array]:
    """Relative size z/r of a smooth stop, and the relative travel at which it is reached."""
    part = np.linspace(0.0, 1.0, MASTER_POINTS)
    size = NEAREST * (1.0 - (1.0 - part) ** 3)
    slope = 1.0 / (1.0 - size**exponent)
    travel = np.concatenate(([0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(size))))
    return size, travel


@njit(cache=True)
def _run_sharp(widths: Array, weights: Array, u: Array, factor: Array, path: float) -> Array:
    stop, out = np.zeros(widths.size), np.empty(u.size)
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
                s = stop[i] + du
                if du > 0.0 and s > r:
                    s = r + keep * max(stop[i] - r, 0.0)
                elif du < 0.0 and s < -r:
                    s = -r - keep * max(-stop[i] - r, 0.0)
                stop[i] = s
                total += weights[i] * s
        out[k] = total
    return out


@njit(cache=True)
def _run_smooth(widths: Array, weights: Array, size: Array, travel: Array, u: Array, factor: Array) -> Array:
    stop, out = np.zeros(widths.size), np.empty(u.size)
    last, total = 0.0, 0.0
    for k in range(u.size):
        du = u[k] - last
        last = u[k]
        if du != 0.0:
            wide = factor[k] if factor.size > 1 else 1.0
            total = 0.0
            for i in range(widths.size):
                stop[i] = _load(stop[i], du, widths[i] * wide, size, travel)
                total += weights[i] * stop[i]
        out[k] = total
    return out


@njit(cache=True)
def _load(z: float, du: float, r: float, size: Array, travel: Array) -> float:
    """Move one smooth stop: unload straight through zero, load along the master curve."""
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
        # Wider than it may be now: what is too much goes within half a width of travel.
        result: float = way * (top * r + (x - top * r) * np.exp(-2.0 * left / r))
        return result
    there = np.interp(x / r, size, travel) + left / r
    return way * r * np.interp(there, travel, size)
