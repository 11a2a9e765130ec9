"""Creep by superposition: the convolution of the rises of the stroke with one creep function J(t).

The laws of J are closed forms, derived for this plant:

- `logarithmic`: log10(1 + t/a) - log10(1 + t/b);
- `fractional`: (1 + t/a)^p - 1, levelling off at b;
- `stretched`: 1 - exp(-(t/c)^q);
- `kelvin`: three elements 1 - exp(-t/c), a decade or more between them;
- `diffusion`: the square root of t, which levels off at b as heat or moisture does in a plate.

J is scaled to a slope of 1 per decade, fitted between `from_s` and `to_s`. The convolution uses fast Fourier
transforms; there is no chain of relaxation elements.
"""

import math
from collections.abc import Callable

import numpy as np

from firmware_sim.concealed.plant.arrays import Array

LAWS = ("logarithmic", "fractional", "stretched")
OTHER_LAWS = ("kelvin", "diffusion")
BEYOND = 2.0  # a = from_s / BEYOND, b = to_s * BEYOND: the slope holds up to the ends of the span
CLIMB_DECADES = 1.34  # a stretched exponential rises from 10 to 90 % within CLIMB_DECADES / q decades

Curve = Callable[[Array], Array]


def curve(law: str, shape: float, from_s: float, to_s: float) -> Curve:
    """Creep function J of a law, with a slope of 1 per decade between two times.

    Parameters
    ----------
    law
        One of `LAWS` or `OTHER_LAWS`.
    shape
        Sets the exponent of the fractional law and the middle of the stretched one, 0 to 1; the logarithmic law has
        none.
    from_s, to_s
        Beginning and end of the span [s].
    """
    raw = _raw(law, shape, from_s / BEYOND, to_s * BEYOND)
    slope = slope_per_decade(raw, from_s, to_s)

    def scaled(after_s: Array) -> Array:
        return raw(after_s) / slope

    return scaled


def slope_per_decade(response: Curve, from_s: float, to_s: float) -> float:
    """Slope of a step response against log10(t), fitted between two times (1 per decade).

    Parameters
    ----------
    response
        Step response as a function of the time [s].
    from_s, to_s
        First and last time of the fit [s], both above 0.
    """
    times_s = np.geomspace(from_s, to_s, 200)
    return float(np.polyfit(np.log10(times_s), response(times_s), 1)[0])


def creep_response(stroke: Array, response: Curve, dt_s: float) -> Array:
    """Creep that the past rises of a stroke add to it, shape (n,), in the unit of the stroke.

    A rise counts at the middle of its step of the grid.

    Parameters
    ----------
    stroke
        Stroke on an equidistant grid, shape (n,); 0 before the first point.
    response
        Creep after a step of 1, as a function of the time since the step [s].
    dt_s
        Spacing of the grid [s], above 0.
    """
    rises = np.diff(stroke, prepend=0.0)
    after_s: Array = np.asarray((np.arange(stroke.size) + 0.5) * dt_s, dtype=np.float64)
    size = _transform_size(2 * stroke.size)
    product = np.fft.rfft(rises, size)
    product *= np.fft.rfft(response(after_s), size)
    result: Array = np.fft.irfft(product, size)[: stroke.size]
    return result


def _raw(law: str, shape: float, a: float, b: float) -> Curve:
    if law == "logarithmic":
        return lambda t: np.log10(1.0 + t / a) - np.log10(1.0 + t / b)
    if law == "fractional":
        power = 0.03 + 0.07 * shape
        return lambda t: (1.0 + t / (a * (1.0 + t / b))) ** power - 1.0
    if law == "kelvin":
        times_s = np.geomspace(2.0 * a, 0.5 * b, 3)
        return lambda t: -np.expm1(-t[..., None] / times_s).sum(axis=-1)
    if law == "diffusion":
        return lambda t: np.sqrt(np.tanh(t / b))
    decades = math.log10(b / a) + 0.6
    middle_s = a * (b / a) ** (0.55 + 0.15 * shape)
    return lambda t: -np.expm1(-((t / middle_s) ** (CLIMB_DECADES / decades)))


def _transform_size(least: int) -> int:
    """Smallest size of at least `least` that is 2, 3 or 5 times a power of two."""
    return min(part << max(0, math.ceil(math.log2(least / part))) for part in (2, 3, 5))
