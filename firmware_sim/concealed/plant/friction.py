"""Elasto-plastic friction: elastic up to break-away, then increasingly plastic.

The state is the deflection z of a bristle, relative to its limit. The travel x is measured in force:

    dz/dx = s (1 - a(z) z sgn(dx)),    a = 0 below break-away, 1 at the limit, half a sine wave in between.

While the motion unloads the bristle, a = 0. The slope s is set so that z reaches 63 % after a given travel from rest.
Source: Dupont, Hayward, Armstrong, Altpeter (2002), Single state elastoplastic friction models,
doi:10.1109/TAC.2002.1000274; the equation in travel instead of time is derived here.
"""

import numpy as np
from numba import njit

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.stops import Stops

LAWS = ("elasto_plastic", "maxwell", "lugre")
ELEMENTS = 15  # of Maxwell slip
LONGEST_PART = 0.02  # [presliding travel]; a longer step is split
REACHED = 1.0 - np.exp(-1.0)
CURVE_POINTS = 4000


def friction_force(force_N: Array, coulomb_N: float, presliding_N: float, break_away: float) -> Array:
    """Friction that opposes a motion, shape (n,) [N].

    Parameters
    ----------
    force_N
        Motion, measured in force, shape (n,) [N].
    coulomb_N
        Limit of the friction [N].
    presliding_N
        Travel from rest after which the friction reaches 63 % of its limit [N].
    break_away
        Share of the limit up to which the friction is elastic, 0 to 1.
    """
    result: Array = coulomb_N * _run(force_N / presliding_N, stiffness(break_away), break_away)
    return result


def lugre_friction(
    force_N: Array, coulomb_N: float, presliding_N: float, static: float, slow_N_per_s: float, dt_s: float
) -> Array:
    """Friction whose limit falls from `static` to 1 with the speed (Stribeck), shape (n,) [N].

    Source: Canudas de Wit, Olsson, Astrom, Lischinsky (1995), A new model for control of systems with friction,
    doi:10.1109/9.376053, without damping.

    Parameters
    ----------
    force_N, coulomb_N, presliding_N
        As for `friction_force`.
    static
        Limit at rest over the limit in motion [1], at least 1.
    slow_N_per_s
        Speed, in force, at which the limit has fallen to 1/e of the way [N/s].
    dt_s
        Spacing of the grid [s].
    """
    speed = np.abs(np.diff(force_N, prepend=force_N[0])) / dt_s
    limit = 1.0 + (static - 1.0) * np.exp(-((speed / slow_N_per_s) ** 2))
    result: Array = coulomb_N * _slide(force_N / presliding_N, limit)
    return result


def maxwell_slip(force_N: Array, coulomb_N: float, presliding_N: float, seed: int) -> Array:
    """Friction of elements that stick to their limit and then slip, shape (n,) [N].

    Source: Lampaert, Al-Bender, Swevers (2003), A generalized Maxwell-slip friction model appropriate for control
    purposes, Physics and Control conference.

    Parameters
    ----------
    force_N, coulomb_N, presliding_N
        As for `friction_force`.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    widths = np.sort(rng.uniform(0.05, 2.5, ELEMENTS))
    weights = rng.uniform(0.5, 1.5, ELEMENTS) * np.exp(-widths)
    weights /= weights @ widths
    travel = np.linspace(0.0, 4.0, CURVE_POINTS)
    reached = float(np.interp(REACHED, np.minimum(travel[:, None], widths) @ weights, travel))
    result: Array = coulomb_N * Stops(widths, weights, 0.0).run(force_N / presliding_N * reached)
    return result


def stiffness(break_away: float) -> float:
    """Initial slope s of the relative friction over the travel / presliding travel (1).

    Parameters
    ----------
    break_away
        Relative friction at which plastic travel begins [1].
    """
    travel = np.linspace(0.0, 4.0, CURVE_POINTS)
    return float(np.interp(REACHED, _run(travel, 1.0, break_away), travel))


@njit(cache=True)
def _run(x: Array, slope: float, break_away: float) -> Array:
    out = np.empty(x.size)
    z, last = 0.0, x[0]
    for k in range(x.size):
        travel = x[k] - last
        last = x[k]
        if travel != 0.0:
            parts = int(abs(travel) / LONGEST_PART) + 1
            part = travel / parts
            for _ in range(parts):
                half = z + 0.5 * part * slope * _yielding(z, part, break_away)
                z += part * slope * _yielding(half, part, break_away)
        out[k] = z
    return out


@njit(cache=True)
def _slide(x: Array, limit: Array) -> Array:
    """State that approaches a limit exponentially with the travel, whose limit is given at every point."""
    out = np.empty(x.size)
    z, last = 0.0, x[0]
    for k in range(x.size):
        travel = x[k] - last
        last = x[k]
        if travel != 0.0:
            end = limit[k] * (1.0 if travel > 0.0 else -1.0)
            z = end + (z - end) * np.exp(-abs(travel) / abs(end))
        out[k] = z
    return out


@njit(cache=True)
def _yielding(z: float, way: float, break_away: float) -> float:
    """Share of the travel that stretches the bristle, 1 - a(z) |z|, 0 to 1."""
    size = abs(z)
    if z * way <= 0.0 or size <= break_away:
        return 1.0
    if size >= 1.0:
        return 0.0
    middle = 0.5 * (1.0 + break_away)
    plastic = 0.5 + 0.5 * np.sin(np.pi * (size - middle) / (1.0 - break_away))
    left: float = 1.0 - plastic * size
    return left
