"""Waveforms: the shapes of force references, and the voltage excitations that a bench is recorded with.

A shape is a function of the phase (periods since the start) with values from -1 to 1 that starts at its low end,
where a stack rests.
"""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MULTISINE_HARMONICS = (1, 2, 3, 5, 8, 13)


def triangle(phase: Array) -> Array:
    """-1 to 1 and back, once a period."""
    result: Array = 1.0 - 4.0 * np.abs(phase % 1.0 - 0.5)
    return result


def sine(phase: Array) -> Array:
    """Minus the cosine: -1 to 1 and back, once a period."""
    return -np.cos(2.0 * np.pi * phase)


def staircase(phase: Array, levels: int) -> Array:
    """`levels` equal treads up and the same down again, once a period."""
    tread = np.floor(triangle_ramp(phase) * levels).clip(0, levels - 1)
    return -1.0 + 2.0 * tread / (levels - 1)


def triangle_ramp(phase: Array) -> Array:
    """The triangle from 0 to 1 and back."""
    return 0.5 * (triangle(phase) + 1.0)


def steps(phase: Array, levels: int, seed: int) -> Array:
    """`levels` holds a period at levels drawn once from `seed`, spread over the whole range."""
    order = np.random.default_rng(seed).permutation(levels)
    values = -1.0 + 2.0 * order / (levels - 1)
    result: Array = values[(np.floor(phase % 1.0 * levels)).astype(int).clip(0, levels - 1)]
    return result


def multisine(phase: Array, seed: int) -> Array:
    """Sum of harmonics with amplitudes as 1/h and phases drawn from `seed`, scaled to -1..1, from its lowest point."""
    shifts = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(MULTISINE_HARMONICS))

    def raw(at: Array) -> Array:
        total = np.zeros_like(at)
        for harmonic, shift in zip(MULTISINE_HARMONICS, shifts, strict=True):
            total += np.cos(2 * np.pi * harmonic * at + shift) / harmonic
        return total

    dense = raw(np.arange(4096) / 4096)
    start = np.argmin(dense) / 4096
    middle, reach = 0.5 * (dense.max() + dense.min()), 0.5 * (dense.max() - dense.min())
    result: Array = ((raw(phase + start) - middle) / reach).clip(-1.0, 1.0)
    return result


def shape(kind: str, phase: Array, *, levels: int = 8, seed: int = 1) -> Array:
    """The shape called `kind` at `phase`, values from -1 to 1."""
    shapes = {
        "triangle": lambda: triangle(phase),
        "sine": lambda: sine(phase),
        "staircase": lambda: staircase(phase, levels),
        "steps": lambda: steps(phase, levels, seed),
        "multisine": lambda: multisine(phase, seed),
    }
    return shapes[kind]()


def whole_periods(frequency_Hz: float, rate_Hz: float) -> tuple[float, int]:
    """Fewest periods that fill a whole number of ticks to one part in a million: (periods, ticks).

    Where a thousand periods are not enough the nearest number of ticks is taken.
    """
    ticks_per_period = Fraction(rate_Hz / frequency_Hz).limit_denominator(1000)
    periods = ticks_per_period.denominator
    return periods, max(1, round(periods * rate_Hz / frequency_Hz))


def constant_triangles(peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """Triangles 0 -> `peak_V` -> 0, the thesis' first excitation [V]."""
    phase = _phase(frequency_Hz, periods, rate_Hz)
    return peak_V * triangle_ramp(phase)


def varying_triangles(peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """Triangles from 0 whose peaks grow to `peak_V` and shrink again, the thesis' second excitation [V]."""
    phase = _phase(frequency_Hz, periods, rate_Hz)
    rising = (periods + 1) // 2
    number = np.floor(phase).clip(0, periods - 1)
    peaks = np.minimum(number + 1, periods - number) / rising
    result: Array = peak_V * peaks * triangle_ramp(phase)
    return result


def _phase(frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """Phase of every tick, both ends included."""
    return np.arange(round(periods * rate_Hz / frequency_Hz) + 1, dtype=np.float64) * frequency_Hz / rate_Hz


EXCITATIONS = ("constant-triangles", "varying-triangles")


def excitation(name: str, peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """The voltage excitation called `name`, from 0 to `peak_V`, one value a tick [V]."""
    makers = {"constant-triangles": constant_triangles, "varying-triangles": varying_triangles}
    return makers[name](peak_V, frequency_Hz, periods, rate_Hz)
