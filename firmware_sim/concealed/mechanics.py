"""The mechanics of a concealed plant: a bent force law, contact, friction."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.arrays import Array


@dataclass(frozen=True)
class ForceLaw:
    """`F = full x (1 + a x + b x^2) / (1 + a + b)` of the relative stroke x.

    Parameters
    ----------
    full_N
        Force at x = 1 [N].
    a, b
        Bend (1).
    """

    full_N: float
    a: float
    b: float

    def __call__(self, x: Array) -> Array:
        """Force at relative strokes, shape (n,) [N]."""
        return self.full_N * x * (1.0 + self.a * x + self.b * x * x) / (1.0 + self.a + self.b)


BENDS = ("hyperbolic", "cubic", "logarithmic")


def bend(force: Array, amount: float, shape: str) -> Array:
    """A relative force that stiffens (amount > 0) or saturates, by one of `BENDS`; unit slope at zero."""
    if shape == "hyperbolic":
        return force / (1.0 - amount * force)
    if shape == "cubic":
        return force + amount * force**2 + 0.3 * amount * force**3
    return -np.log1p(-2.0 * amount * force) / (2.0 * amount)


def curvature(amount: float, shape: str) -> float:
    """Second-order part c of the law g (x + c x^2) that comes closest to a bend over 0 to 1."""
    x = np.linspace(0.0, 1.0, 501)
    slope, square = np.linalg.lstsq(np.column_stack((x, x * x)), bend(x, amount, shape), rcond=None)[0]
    return float(square / slope)


def amount_of(wanted: float, shape: str) -> float:
    """Amount of a bend whose curvature is the one wanted, by bisection."""
    low, high = -0.45, 0.45
    for _ in range(60):
        middle = 0.5 * (low + high)
        if middle == 0.0 or curvature(middle, shape) < wanted:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def contact(force_N: Array, gap_N: float, softness_N: float) -> Array:
    """What arrives of a force when the first `gap_N` close a gap; a hyperbola about the corner [N]."""

    def arrives(f: Array) -> Array:
        excess = f - gap_N
        return 0.5 * (excess + np.hypot(excess, softness_N))

    return arrives(force_N) - arrives(np.zeros(1))


@njit(cache=True)
def rub(force_N: Array, coulomb_N: float, presliding_N: float, exponent: float) -> Array:
    """Friction that opposes a motion measured in force [N]: Dahl's law with an exponent, exact for any step.

    `dz/dx = s (1 - z sgn(dx) / z_max)^i`: with q = 1 - z sgn(dx) / z_max, q^(1-i) falls linearly with the travel. s is
    such that 63 % of `coulomb_N` is there after a travel of `presliding_N` from rest.
    """
    power = 1.0 - exponent
    pace = 1.0 / presliding_N if abs(power) < 1e-6 else (1.0 - np.exp(-power)) / power / presliding_N
    out = np.empty(force_N.size)
    z, last = 0.0, force_N[0]
    for k in range(force_N.size):
        dx = force_N[k] - last
        last = force_N[k]
        if dx != 0.0:
            way = 1.0 if dx > 0.0 else -1.0
            q = max(1.0 - way * z, 1e-12)
            if abs(power) < 1e-6:
                q *= np.exp(-pace * abs(dx))
            else:
                rest = q**power - power * pace * abs(dx)
                q = max(rest, 0.0) ** (1.0 / power) if rest > 0.0 else 0.0
            z = way * (1.0 - q)
        out[k] = coulomb_N * z
    return out
