"""Waveforms: the shapes of force references, and the voltage excitations that a bench is recorded with.

A shape is a function of the phase (periods since the start) with values from -1 to 1 that starts at its low end,
where a stack rests.
"""

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MULTISINE_HARMONICS = (1, 2, 3, 5, 8, 13)

# The third excitation; voltages as parts of the peak, times in periods of its main triangle. All chosen here.
VIRGIN_SLOWNESS = 8.0  # the plays above half the peak move in the virgin rise only: it must last
STAIRCASE_LEVELS = 8
DWELL_PERIODS = 0.1
MINOR_LOOP_BIASES = (0.2, 0.5, 0.8)
MINOR_LOOP_SIZES = (0.1, 0.25)  # from end to end
REVERSAL_DEPTHS = (0.8, 0.6, 0.4, 0.2)  # below the peak, deepest first: a fan of first-order reversals
NESTED_REVERSALS = (0.1, 0.9, 0.2, 0.8, 0.3, 0.7, 0.4, 0.6, 0.5)
MULTISINE_RANGE = (0.1, 0.9)
MULTISINE_PERIOD = 2.0  # of its lowest harmonic
MULTISINE_REPEATS = 2


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


def staircase_minor_loops_multisine(peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """One record that tells plays, dead zones and virgin curve apart, from 0 to `peak_V` and back [V].

    In this order: the virgin rise in steps at an eighth of the slew, a full triangle, minor loops of two sizes at three
    biases, a staircase down and up with dwells, a fan of reversals from the peak, nested reversals that decay to the
    middle, a multisine, and the return to 0. Steady triangles leave every play with a threshold above `peak_V` / 2
    frozen (piezod/operators/README.md, "Limits of validity"); the virgin rise moves them, and the reversals separate
    those below.

    Parameters
    ----------
    peak_V, frequency_Hz
        Of the main triangle; every ramp has its slew, 2 `peak_V` `frequency_Hz`, and the multisine under twice that.
    periods
        Repeats of the whole; only the first of them starts on the virgin curve.
    rate_Hz
        Samples a second.
    """
    times, levels, multisine_start = _identification_corners()
    phase = _phase(frequency_Hz, periods * float(times[-1]), rate_Hz)
    within = np.where(phase < periods * times[-1], phase % times[-1], times[-1])
    parts = np.interp(within, times, levels)
    wave = (within - multisine_start) / MULTISINE_PERIOD
    inside = (wave >= 0.0) & (wave < MULTISINE_REPEATS)
    low, high = MULTISINE_RANGE
    parts[inside] = low + 0.5 * (high - low) * (1.0 + multisine(wave[inside], seed=1))
    result: Array = peak_V * parts
    return result


def _identification_corners() -> tuple[Array, Array, float]:
    """Corners of the third excitation: times [periods of the triangle], levels [parts of the peak], multisine's start.

    A level that follows itself is held.
    """
    treads = np.arange(1, STAIRCASE_LEVELS + 1) / STAIRCASE_LEVELS
    up, down = np.repeat(treads, 2), np.repeat(1.0 - treads, 2)
    virgin = [0.0, 0.0, *up]
    loops = [
        bias + side * 0.5 * size
        for bias in MINOR_LOOP_BIASES
        for size in MINOR_LOOP_SIZES
        for side in (1.0, -1.0, 1.0, -1.0, 1.0)
    ]
    fan = [level for depth in REVERSAL_DEPTHS for level in (1.0 - depth, 1.0)]
    floor = MULTISINE_RANGE[0]
    before = [*virgin, 0.0, 1.0, 0.0, *loops, 1.0, *down, *up, *fan, *NESTED_REVERSALS, floor]
    levels = np.array([*before, floor, 0.0, 0.0])
    travel = 0.5 * np.abs(np.diff(levels))
    travel[: len(virgin) - 1] *= VIRGIN_SLOWNESS
    lasts = np.where(travel > 0.0, travel, DWELL_PERIODS)
    lasts[len(before) - 1] = MULTISINE_REPEATS * MULTISINE_PERIOD
    times = np.concatenate(([0.0], np.cumsum(lasts)))
    return times, levels, float(times[len(before) - 1])


def _phase(frequency_Hz: float, periods: float, rate_Hz: float) -> Array:
    """Phase of every tick, both ends included."""
    return np.arange(round(periods * rate_Hz / frequency_Hz) + 1, dtype=np.float64) * frequency_Hz / rate_Hz


IDENTIFICATION = "staircase-minor-loops-multisine"
TRIANGLES = ("constant-triangles", "varying-triangles")
EXCITATIONS = (*TRIANGLES, IDENTIFICATION)


def excitation(name: str, peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """The voltage excitation called `name`, from 0 to `peak_V`, one value a tick [V]."""
    makers = {
        "constant-triangles": constant_triangles,
        "varying-triangles": varying_triangles,
        IDENTIFICATION: staircase_minor_loops_multisine,
    }
    return makers[name](peak_V, frequency_Hz, periods, rate_Hz)


def default_periods(name: str) -> int:
    """How often an excitation is repeated unless one says so: five triangles; what tells all in one run, once."""
    return 5 if name in TRIANGLES else 1


def duration_s(name: str, frequency_Hz: float, periods: int) -> float:
    """How long the excitation called `name` lasts [s]."""
    triangles = float(_identification_corners()[0][-1]) if name == IDENTIFICATION else 1.0
    return periods * triangles / frequency_Hz
