"""Waveform shapes for force references, and voltage excitations for the recordings of a bench.

A shape is a function of the phase, the time in periods since the start. Its values lie between -1 and 1.
It starts at or near -1, the rest position of a stack.
"""

from fractions import Fraction

import numpy as np

from piezod.arrays import Array

MULTISINE_HARMONICS = (1, 2, 3, 5, 8, 13)

# The identification record: voltages relative to the peak, times in periods of its main triangle. Values chosen here.
VIRGIN_SLOWDOWN = 8.0  # plays with a threshold above half the peak move only in the virgin rise
STAIRCASE_LEVELS = 8
DWELL_PERIODS = 0.1
MINOR_LOOP_BIASES = (0.2, 0.5, 0.8)
MINOR_LOOP_SIZES = (0.1, 0.25)  # peak to peak
REVERSAL_DEPTHS = (0.8, 0.6, 0.4, 0.2)  # below the peak, deepest first: first-order reversal curves
NESTED_REVERSALS = (0.1, 0.9, 0.2, 0.8, 0.3, 0.7, 0.4, 0.6, 0.5)
MULTISINE_RANGE = (0.1, 0.9)
MULTISINE_PERIOD = 2.0  # period of the lowest harmonic
MULTISINE_REPEATS = 2


def triangle(phase: Array) -> Array:
    """Triangle from -1 to 1 and back in one period, shape (N,).

    Parameters
    ----------
    phase
        Phase [periods], shape (N,).
    """
    result: Array = 1.0 - 4.0 * np.abs(phase % 1.0 - 0.5)
    return result


def sine(phase: Array) -> Array:
    """Negative cosine: from -1 to 1 and back in one period, shape (N,).

    Parameters
    ----------
    phase
        Phase [periods], shape (N,).
    """
    return -np.cos(2.0 * np.pi * phase)


def staircase(phase: Array, levels: int) -> Array:
    """Staircase of equal levels from -1 to 1, up and down in one period, shape (N,).

    Parameters
    ----------
    phase, levels
        Phase [periods], shape (N,); number of levels, at least 2.
    """
    level = np.floor(triangle_ramp(phase) * levels).clip(0, levels - 1)
    return -1.0 + 2.0 * level / (levels - 1)


def triangle_ramp(phase: Array) -> Array:
    """Triangle from 0 to 1 and back in one period, shape (N,).

    Parameters
    ----------
    phase
        Phase [periods], shape (N,).
    """
    return 0.5 * (triangle(phase) + 1.0)


def steps(phase: Array, levels: int, seed: int) -> Array:
    """Constant sections, equally spaced from -1 to 1, in a random order that every period repeats, shape (N,).

    Parameters
    ----------
    phase, levels, seed
        Phase [periods], shape (N,); sections per period, at least 2; seed of the order.
    """
    order = np.random.default_rng(seed).permutation(levels)
    values = -1.0 + 2.0 * order / (levels - 1)
    result: Array = values[(np.floor(phase % 1.0 * levels)).astype(int).clip(0, levels - 1)]
    return result


def multisine(phase: Array, seed: int) -> Array:
    """Sum of harmonics h, amplitude 1/h, with random phases, scaled to -1..1, shape (N,); starts at its minimum.

    Parameters
    ----------
    phase, seed
        Phase [periods], shape (N,); seed of the phases.
    """
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
    """The shape `kind`, values from -1 to 1, shape (N,); KeyError for an unknown kind.

    Parameters
    ----------
    kind
        "triangle", "sine", "staircase", "steps" or "multisine".
    phase, levels, seed
        Phase [periods], shape (N,); for "staircase" and "steps" at least 2; for "steps" and "multisine".
    """
    shapes = {
        "triangle": lambda: triangle(phase),
        "sine": lambda: sine(phase),
        "staircase": lambda: staircase(phase, levels),
        "steps": lambda: steps(phase, levels, seed),
        "multisine": lambda: multisine(phase, seed),
    }
    return shapes[kind]()


def whole_periods(frequency_Hz: float, rate_Hz: float) -> tuple[float, int]:
    """Smallest number of periods that fill a whole number of ticks: (periods, ticks).

    At most 1000 periods; if none fits, the number of ticks is rounded.

    Parameters
    ----------
    frequency_Hz
        Frequency of the waveform [Hz].
    rate_Hz
        Ticks per second [Hz].
    """
    ticks_per_period = Fraction(rate_Hz / frequency_Hz).limit_denominator(1000)
    periods = ticks_per_period.denominator
    return periods, max(1, round(periods * rate_Hz / frequency_Hz))


def constant_triangles(peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """Triangles 0 -> `peak_V` -> 0, one value per tick, shape (N,) [V]; the first excitation of the thesis.

    Parameters
    ----------
    peak_V, frequency_Hz
        Highest voltage [V]; frequency of the triangles [Hz], above 0.
    periods, rate_Hz
        Number of triangles, at least 1; tick rate [Hz], above 0.
    """
    phase = _phase(frequency_Hz, periods, rate_Hz)
    return peak_V * triangle_ramp(phase)


def varying_triangles(peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """Triangles from 0, peaks rise to `peak_V` and fall again, shape (N,) [V]; the second excitation of the thesis.

    Parameters
    ----------
    peak_V, frequency_Hz, periods, rate_Hz
        As in `constant_triangles`.
    """
    phase = _phase(frequency_Hz, periods, rate_Hz)
    rising = (periods + 1) // 2
    number = np.floor(phase).clip(0, periods - 1)
    peaks = np.minimum(number + 1, periods - number) / rising
    result: Array = peak_V * peaks * triangle_ramp(phase)
    return result


def staircase_minor_loops_multisine(peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """Identification record from 0 to `peak_V` and back [V], which determines plays, dead zones and virgin curve.

    Its sections, in this order:

    1. Virgin rise in steps, at an eighth of the slew.
    2. One full triangle.
    3. Minor loops of two sizes at three biases.
    4. Staircase down and up, with a constant voltage after each step.
    5. Reversals from the peak to four depths.
    6. Nested reversals around the middle, with decreasing amplitude.
    7. Multisine, and the return to 0.

    After the first rise, steady triangles move no play with a threshold above `peak_V` / 2 (piezod/operators/README.md,
    "Limits of validity"). The virgin rise moves these plays. The reversals separate the plays with lower thresholds.

    Parameters
    ----------
    peak_V, frequency_Hz
        Peak [V] and frequency [Hz] of the main triangle. Every ramp except the virgin rise has its slew of
        2 `peak_V` `frequency_Hz`. The slew of the multisine is less than twice this value.
    periods
        Number of repetitions; only the first starts on the virgin curve.
    rate_Hz
        Samples per second [Hz].
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
    """Corners of the identification record: times [triangle periods], levels [peak], start of the multisine.

    Two equal consecutive levels form a section of constant voltage.
    """
    steps_up = np.arange(1, STAIRCASE_LEVELS + 1) / STAIRCASE_LEVELS
    up, down = np.repeat(steps_up, 2), np.repeat(1.0 - steps_up, 2)
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
    travel[: len(virgin) - 1] *= VIRGIN_SLOWDOWN
    durations = np.where(travel > 0.0, travel, DWELL_PERIODS)
    durations[len(before) - 1] = MULTISINE_REPEATS * MULTISINE_PERIOD
    times = np.concatenate(([0.0], np.cumsum(durations)))
    return times, levels, float(times[len(before) - 1])


def _phase(frequency_Hz: float, periods: float, rate_Hz: float) -> Array:
    """Phase at every tick, including both ends."""
    return np.arange(round(periods * rate_Hz / frequency_Hz) + 1, dtype=np.float64) * frequency_Hz / rate_Hz


IDENTIFICATION = "staircase-minor-loops-multisine"
TRIANGLES = ("constant-triangles", "varying-triangles")
EXCITATIONS = (*TRIANGLES, IDENTIFICATION)


def excitation(name: str, peak_V: float, frequency_Hz: float, periods: int, rate_Hz: float) -> Array:
    """The voltage excitation `name`, 0 to `peak_V`, one value per tick, shape (N,) [V]; KeyError for an unknown name.

    Parameters
    ----------
    name
        One of `EXCITATIONS`.
    peak_V, frequency_Hz, periods, rate_Hz
        As in `constant_triangles`.
    """
    makers = {
        "constant-triangles": constant_triangles,
        "varying-triangles": varying_triangles,
        IDENTIFICATION: staircase_minor_loops_multisine,
    }
    return makers[name](peak_V, frequency_Hz, periods, rate_Hz)


def default_periods(name: str) -> int:
    """Default number of periods: 5 for triangles, 1 for the identification record.

    Parameters
    ----------
    name
        One of `EXCITATIONS`.
    """
    return 5 if name in TRIANGLES else 1


def duration_s(name: str, frequency_Hz: float, periods: int) -> float:
    """Duration of the excitation `name` [s].

    Parameters
    ----------
    name, frequency_Hz, periods
        As in `excitation`.
    """
    triangles = float(_identification_corners()[0][-1]) if name == IDENTIFICATION else 1.0
    return periods * triangles / frequency_Hz
