"""A drive signal with all kinds of movement in one record, for a diagnosis.

Every section is drawn from a seed: sines of 0.3 to 5 Hz, triangles, steps with holds, ramps, minor loops of one size
at three biases, and holds of two seconds; a ramp connects successive sections.
"""

import numpy as np

RAMP_s = 0.2  # between two sections
LONG_HOLD_s = 2.0


def mixed_work(seed: int, duration_s: float, rate_Hz: float, peak_V: float) -> np.ndarray:
    """Voltages from 0 to `peak_V` for each tick [V]; every kind occurs once before any repeats."""
    rng = np.random.default_rng(seed)
    parts, order, ticks = [np.zeros(round(RAMP_s * rate_Hz))], [], 0
    while ticks < duration_s * rate_Hz:
        if not order:
            order = rng.permutation(len(KINDS)).tolist()
        section = np.clip(KINDS[order.pop()](rng, rate_Hz), 0.0, 1.0) * peak_V
        parts += [np.linspace(parts[-1][-1], section[0], round(RAMP_s * rate_Hz)), section]
        ticks = sum(part.size for part in parts)
    return np.concatenate(parts)[: round(duration_s * rate_Hz)]


def _time_s(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    return np.arange(int(rng.uniform(1.5, 3.0) * rate_Hz)) / rate_Hz


def _reach(rng: np.random.Generator) -> tuple[float, float]:
    """Middle and half the range, as shares of the peak."""
    reach = rng.uniform(0.1, 0.5)
    return rng.uniform(reach, 1.0 - reach), reach


def _sine(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    middle, reach = _reach(rng)
    frequency_Hz = 10 ** rng.uniform(-0.5, 0.7)
    return middle - reach * np.cos(2 * np.pi * frequency_Hz * _time_s(rng, rate_Hz))


def _triangles(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    middle, reach = _reach(rng)
    phase = 10 ** rng.uniform(-0.5, 0.4) * _time_s(rng, rate_Hz)
    return middle + reach * (4.0 * np.abs(phase % 1.0 - 0.5) - 1.0)


def _steps(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    return np.repeat(rng.uniform(0.0, 1.0, 5), round(0.5 * rate_Hz))


def _ramps(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    time_s = _time_s(rng, rate_Hz)
    return np.interp(time_s, np.linspace(0.0, time_s[-1], 6), rng.uniform(0.0, 1.0, 6))


def _minor_loops(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    half = 0.5 * rng.uniform(0.1, 0.3)
    corners = [bias + side * half for bias in (0.2, 0.5, 0.8) for side in (-1.0, 1.0, -1.0, 1.0)]
    return np.interp(np.arange(round(3.0 * rate_Hz)) / rate_Hz, np.linspace(0.0, 3.0, len(corners)), corners)


def _rest(rng: np.random.Generator, rate_Hz: float) -> np.ndarray:
    """A step, two seconds of rest, a step to 0, and rest."""
    held = round(LONG_HOLD_s * rate_Hz)
    return np.concatenate([np.full(held, rng.uniform(0.3, 1.0)), np.zeros(held // 2)])


KINDS = (_sine, _triangles, _steps, _ramps, _minor_loops, _rest)
