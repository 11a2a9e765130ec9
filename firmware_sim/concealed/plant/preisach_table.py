"""Preisach operators from tabulated Everett functions, with a last-in first-out memory of reversals.

The change of the output between two reversals x < y is the Everett function `E(x, y)`. There are two kinds:

- the density depends on the width of the relays alone, so that E depends on y - x alone;
- the density depends on the bias too: E is tabulated over x and y, with bilinear interpolation.

Source: Mayergoyz (1991), Mathematical Models of Hysteresis, chapter 1. The densities are chosen here.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array

WIDTH_POINTS = 20_001
GRID_POINTS = 401  # of an axis of E(x, y)
MOST_REVERSALS = 512  # that the memory holds


@dataclass(frozen=True)
class Everett:
    """Tables over -`reach_V` to `reach_V`; the virgin curve ends at `reach_V`.

    Parameters
    ----------
    reach_V
        Largest input [V].
    by_width
        E over y - x = 0 to 2 reach, shape (WIDTH_POINTS,) [V], or a single zero.
    by_bias
        E over x and y, shape (GRID_POINTS, GRID_POINTS) [V], or a single zero.
    virgin
        Output on the first rise, over 0 to reach, shape (WIDTH_POINTS,) [V].
    """

    reach_V: float
    by_width: Array
    by_bias: Array
    virgin: Array

    def run(self, voltage_V: Array) -> Array:
        """Output over an input from the demagnetised state, shape (n,) [V]."""
        result: Array = _run(self.reach_V, self.by_width, self.by_bias, self.virgin, voltage_V)
        return result


def everett_by_width(rng: np.random.Generator, reach_V: float) -> Everett:
    """Draw a density of the width alone: a sum of two to four Gaussians.

    Parameters
    ----------
    reach_V
        Highest voltage of the plant [V], above 0.
    """
    d = np.linspace(0.0, 2.0 * reach_V, WIDTH_POINTS)
    density = np.zeros(d.size)
    for _ in range(rng.integers(2, 5)):
        centre, spread = rng.uniform(0.0, 0.9) * reach_V, rng.uniform(0.15, 0.5) * reach_V
        density += rng.uniform(0.3, 1.0) * np.exp(-0.5 * ((d - centre) / spread) ** 2)
    table = _integral(_integral(density, d), d)
    return _of_width(reach_V, table)


def everett_interpolated(rng: np.random.Generator, reach_V: float) -> Everett:
    """Draw a measured branch: 8 to 14 unevenly spaced points of a loop, straight lines between them.

    Parameters
    ----------
    reach_V
        Highest voltage of the plant [V], above 0.
    """
    d = np.linspace(0.0, 2.0 * reach_V, WIDTH_POINTS)
    inner = np.sort(rng.uniform(0.02, 1.9, int(rng.integers(8, 15)))) * reach_V
    knots = np.concatenate(([0.0], inner, [2.0 * reach_V]))
    branch = (knots / reach_V) ** rng.uniform(1.2, 1.6) * np.exp(rng.normal(0.0, 0.01, knots.size))
    table = np.interp(d, knots, np.maximum.accumulate(branch))
    return _of_width(reach_V, table)


def everett_by_bias(rng: np.random.Generator, reach_V: float) -> Everett:
    """Draw a density that also depends on the bias (a + b) / 2: a ridge across the plane.

    Parameters
    ----------
    reach_V
        Highest voltage of the plant [V], above 0.
    """
    axis = np.linspace(-reach_V, reach_V, GRID_POINTS)
    b, a = np.meshgrid(axis, axis, indexing="ij")
    width, bias = a - b, 0.5 * (a + b)
    density = np.exp(-width / (rng.uniform(0.25, 0.6) * reach_V))
    centre, spread = rng.uniform(0.1, 0.9) * reach_V, rng.uniform(0.15, 0.35) * reach_V
    density *= 0.25 + np.exp(-0.5 * ((bias - centre) / spread) ** 2)
    density[a < b] = 0.0
    density[a == b] *= 0.5
    cell = (axis[1] - axis[0]) ** 2
    # E(x, y) sums the density over b >= x and a <= y.
    table = np.cumsum(np.cumsum(density[::-1, :], axis=0)[::-1, :], axis=1) * cell
    table[a <= b] = 0.0
    up = np.where((a > 0.0) & (b > -a), density, 0.0).sum(axis=0) * cell
    virgin = np.interp(np.linspace(0.0, reach_V, WIDTH_POINTS), axis, np.cumsum(up))
    virgin -= virgin[0]
    scale = reach_V / virgin[-1]
    return Everett(reach_V, np.zeros(1), scale * table, scale * virgin)


def _of_width(reach_V: float, table: Array) -> Everett:
    """E over y - x from a table over 0 to 2 `reach_V`, scaled to end its virgin curve at `reach_V`."""
    virgin = 0.5 * table
    scale = reach_V / virgin[-1]
    return Everett(reach_V, scale * table, np.zeros((1, 1)), scale * virgin)


def _integral(values: Array, points: Array) -> Array:
    """Running integral by the trapezoidal rule, shape (n,)."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(points)
    return np.concatenate(([0.0], np.cumsum(steps)))


@njit(cache=True)
def _lookup(reach_V: float, by_width: Array, by_bias: Array, low: float, high: float) -> float:
    total = 0.0
    if by_width.size > 1:
        at = (high - low) / (2.0 * reach_V) * (by_width.size - 1)
        k = min(int(at), by_width.size - 2)
        total += by_width[k] + (at - k) * (by_width[k + 1] - by_width[k])
    if by_bias.shape[0] > 1:
        n = by_bias.shape[0] - 1
        p, q = (low / reach_V + 1.0) * 0.5 * n, (high / reach_V + 1.0) * 0.5 * n
        i, j = min(max(int(p), 0), n - 1), min(max(int(q), 0), n - 1)
        f, g = p - i, q - j
        left = by_bias[i, j] * (1.0 - g) + by_bias[i, j + 1] * g
        right = by_bias[i + 1, j] * (1.0 - g) + by_bias[i + 1, j + 1] * g
        total += left * (1.0 - f) + right * f
    return total


@njit(cache=True)
def _virgin(reach_V: float, virgin: Array, u: float) -> float:
    at = max(u, 0.0) / reach_V * (virgin.size - 1)
    k = min(int(at), virgin.size - 2)
    value: float = virgin[k] + (at - k) * (virgin[k + 1] - virgin[k])
    return value


@njit(cache=True)
def _run(reach_V: float, by_width: Array, by_bias: Array, virgin: Array, u: Array) -> Array:
    corner, level = np.empty(MOST_REVERSALS), np.empty(MOST_REVERSALS)
    out = np.empty(u.size)
    depth, heading = 0, 0.0
    last, value = 0.0, 0.0
    for k in range(u.size):
        move = u[k] - last
        if move != 0.0:
            way = 1.0 if move > 0.0 else -1.0
            if heading * way < 0.0:
                if depth == MOST_REVERSALS:
                    depth -= 2
                corner[depth], level[depth] = last, value
                depth += 1
            heading, last = way, u[k]
            while depth >= 2 and way * (last - corner[depth - 2]) >= 0.0:
                depth -= 2
            if depth == 1 and last >= corner[0]:
                depth = 0
            if depth == 0:
                value = _virgin(reach_V, virgin, last)
            else:
                x = corner[depth - 1]
                weight = _lookup(reach_V, by_width, by_bias, min(x, last), max(x, last))
                value = level[depth - 1] + way * weight
        out[k] = value
    return out
