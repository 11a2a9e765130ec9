"""Creep as a spectrum of retardation times, of a law drawn at random, scaled to its measured slope per decade.

Laws: `lumpy` (equal on the logarithm of time up to random lumps), `power` (a fractional element, t^a) and `stretched`
(a broad bell on the logarithm of time). Each element answers exactly: `dx/dt = (c v - x) / tau` with v straight or
held.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from firmware_sim.concealed.arrays import Array

PER_DECADE = 5  # elements
FADE_DECADES = 0.5  # beyond both ends of the span, so that the slope holds up to them


@dataclass(frozen=True)
class Spectrum:
    """Retardation times [s] and compliances (1), shapes (k,)."""

    times_s: Array
    compliances: Array

    def step_response(self, after_s: Array) -> Array:
        """What is added to a unit step after a time, shape (n,) (1)."""
        rise: Array = -np.expm1(-after_s[:, None] / self.times_s)
        return rise @ self.compliances

    def run(self, stroke: Array, dt_s: float, *, stairs: bool) -> Array:
        """What is added to a stroke on the grid, shape (n,)."""
        keep = np.exp(-dt_s / self.times_s)
        constant = -np.expm1(-dt_s / self.times_s)
        ramp = np.zeros(keep.size) if stairs else 1.0 - constant * self.times_s / dt_s
        result: Array = _run(stroke, keep, constant * self.compliances, ramp * self.compliances)
        return result


def draw_spectrum(rng: np.random.Generator, law: str, from_s: float, to_s: float) -> Spectrum:
    """Draw a spectrum of a law whose slope per decade between two times is 1."""
    low, high = np.log10(from_s) - FADE_DECADES, np.log10(to_s) + FADE_DECADES
    place = np.linspace(low, high, int(np.ceil((high - low) * PER_DECADE)) + 1)
    if law == "lumpy":
        weight = rng.uniform(0.75, 1.25, place.size)
    elif law == "power":
        weight = 10.0 ** (rng.uniform(0.03, 0.1) * (place - low))
    else:
        middle = 0.5 * (low + high) + rng.uniform(-0.3, 0.3)
        weight = np.exp(-0.5 * ((place - middle) / (0.75 * (high - low))) ** 2)
    spectrum = Spectrum(10.0**place, weight)
    return Spectrum(spectrum.times_s, weight / slope_per_decade(spectrum, from_s, to_s))


def slope_per_decade(spectrum: Spectrum, from_s: float, to_s: float) -> float:
    """Slope of the step response against the logarithm of time, fitted between two times."""
    times_s = np.geomspace(from_s, to_s, 200)
    return float(np.polyfit(np.log10(times_s), spectrum.step_response(times_s), 1)[0])


@njit(cache=True)
def _run(stroke: Array, keep: Array, constant: Array, ramp: Array) -> Array:
    x, out = np.zeros(keep.size), np.empty(stroke.size)
    last = 0.0
    for k in range(stroke.size):
        rise = stroke[k] - last
        total = 0.0
        for i in range(keep.size):
            x[i] = keep[i] * x[i] + constant[i] * last + ramp[i] * rise
            total += x[i]
        last = stroke[k]
        out[k] = total
    return out
