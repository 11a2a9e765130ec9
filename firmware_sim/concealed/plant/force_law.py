"""Force laws of a concealed plant: the base law, the output nonlinearity and the contact gap; derived here."""

from dataclasses import dataclass

import numpy as np

from firmware_sim.concealed.plant.arrays import Array


@dataclass(frozen=True)
class ForceLaw:
    """Base force law `F = full x (1 + a x + b x^2) / (1 + a + b)` of the relative stroke x.

    Parameters
    ----------
    full_N
        Force at x = 1 [N].
    a, b
        Coefficients of the curvature (1).
    """

    full_N: float
    a: float
    b: float

    def __call__(self, x: Array) -> Array:
        """Force at relative strokes, shape (n,) [N]."""
        return self.full_N * x * (1.0 + self.a * x + self.b * x * x) / (1.0 + self.a + self.b)


MOST_AMOUNT = 0.48  # largest |amount| of a bend
BENDS = ("hyperbolic", "power", "logarithmic")


def bend(force: Array, amount: float, shape: str) -> Array:
    """Relative force behind a law that stiffens (amount > 0) or saturates; its slope at zero is 1.

    Parameters
    ----------
    force
        Relative force, 0 to 1, shape (n,).
    amount
        Strength of the bend, -`MOST_AMOUNT` to `MOST_AMOUNT`, not 0.
    shape
        One of `BENDS`.
    """
    if shape == "hyperbolic":
        return force / (1.0 - amount * force)
    if shape == "power":
        power: Array = ((1.0 + force) ** (1.0 + 2.0 * amount) - 1.0) / (1.0 + 2.0 * amount)
        return power
    return -np.log1p(-2.0 * amount * force) / (2.0 * amount)


def curvature(amount: float, shape: str) -> float:
    """Curvature c of the law g (x + c x^2) fitted to a bend over x = 0 to 1 by least squares (1).

    Parameters
    ----------
    amount, shape
        As in `bend`.
    """
    x = np.linspace(0.0, 1.0, 501)
    slope, square = np.linalg.lstsq(np.column_stack((x, x * x)), bend(x, amount, shape), rcond=None)[0]
    return float(square / slope)


def amount_for_curvature(target: float, shape: str) -> float:
    """Amount of a bend with a given curvature, by bisection.

    Parameters
    ----------
    target
        Curvature [1]; its sign is the sign of the amount.
    shape
        As in `bend`.

    Returns
    -------
    Amount, at most `MOST_AMOUNT` in size [1].
    """
    low, high = (0.0, MOST_AMOUNT) if target > 0.0 else (-MOST_AMOUNT, 0.0)
    for _ in range(50):
        middle = 0.5 * (low + high)
        if curvature(middle, shape) < target:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def contact(force_N: Array, gap_N: float, softness_N: float) -> Array:
    """Force that arrives behind a gap, shape (n,) [N]; a hyperbola rounds the corner at `gap_N`.

    Parameters
    ----------
    force_N
        Force in front of the gap, shape (n,) [N].
    gap_N
        Force that closes the gap [N].
    softness_N
        Width of the rounded corner [N], at least 0.
    """

    def arrives(f: Array) -> Array:
        excess = f - gap_N
        return 0.5 * (excess + np.hypot(excess, softness_N))

    return arrives(force_N) - arrives(np.zeros(1))
