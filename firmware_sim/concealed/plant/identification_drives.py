"""Commands of identification records as different laboratories drive them, relative to the range.

- `triangles`: `drives.identification_voltage`, faster in a short record;
- `staircase`: flights of equal steps up and down, with a hold on every tread;
- `decaying sine`: around the middle, or from zero, with a falling amplitude;
- `repeated sine`: two or three equal periods over the full range;
- `random walk`: slow and smooth, over the full range.

Every record begins at rest at 0. Its first samples lead to the state in which some benches begin to write.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.drives import identification_voltage

LEISURELY_S = 60.0  # a shorter record is driven faster
REST_S = (0.2, 1.0)


class Commands(NamedTuple):
    """Commands of a record.

    `levels`: relative to the range, 0 to 1, shape (n,). `lead`: samples before a bench without rest begins to write.
    """

    levels: Array
    lead: int


Draw = Callable[[np.random.Generator, float, float], Commands]
"""Commands from a source of random draws, the sample rate [Hz] and the longest duration [s]."""


def rest(rng: np.random.Generator, rate_Hz: float, pace: float = 1.0) -> Array:
    """Zeros for a drawn time, shape (n,), n at least 1; `pace`: speed relative to an ordinary record."""
    return np.zeros(max(1, round(rng.uniform(*REST_S) / pace * rate_Hz)))


def pace_of(duration_s: float) -> float:
    """Speed of a record relative to one of `LEISURELY_S`, at least 1."""
    return max(1.0, LEISURELY_S / duration_s)


def eased(start: float, end: float, samples: int) -> Array:
    """Half a cosine wave from `start` towards `end`, shape (samples,)."""
    part = np.arange(samples) / max(samples, 1)
    return start + (end - start) * (0.5 - 0.5 * np.cos(np.pi * part))


def _triangles(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    pace = pace_of(duration_s)
    return Commands(identification_voltage(rng, 1.0, rate_Hz / pace, duration_s * pace), 0)


def _staircase(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    """One to three flights, each with its own number of steps; the last tread lasts to the end."""
    begin = rest(rng, rate_Hz, pace_of(duration_s))
    levels: list[float] = []
    for _ in range(int(rng.integers(1, 4))):
        up = np.arange(1, int(rng.integers(6, 16)) + 1, dtype=float)
        levels += [*(up / up[-1]), *(up[-2::-1] / up[-1]), 0.0]
    samples = round(duration_s * rate_Hz)
    tread = (samples - begin.size) // len(levels)
    rise = min(round(rng.uniform(0.002, 0.1) * rate_Hz), tread // 2)
    parts = [begin]
    for before, level in zip([0.0, *levels], levels, strict=False):
        parts += [np.linspace(before, level, rise, endpoint=False), np.full(tread - rise, level)]
    parts.append(np.full(samples - begin.size - tread * len(levels), 0.0))
    return Commands(np.concatenate(parts), 0)


def _decaying_sine(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    begin = rest(rng, rate_Hz, pace_of(duration_s))
    count = round(duration_s * rate_Hz) - begin.size
    part = np.arange(count) / count
    fade = 1.0 - 0.95 * part if rng.random() < 0.5 else np.exp(-rng.uniform(2.0, 4.0) * part)
    phase = 2.0 * np.pi * rng.integers(8, 30) * part
    if rng.random() < 0.5:
        return Commands(np.concatenate((begin, fade * (0.5 - 0.5 * np.cos(phase)))), begin.size)
    approach = min(round(rng.uniform(0.02, 0.05) * count), count)
    rise = eased(0.0, 0.5, approach)
    wave = 0.5 + 0.5 * fade * np.sin(phase)
    return Commands(np.concatenate((begin, rise, wave))[: begin.size + count], begin.size + approach)


def _repeated_sine(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    """Rest and two or three periods; a bench without rest begins within a first period that it does not write."""
    begin = rest(rng, rate_Hz)
    periods = int(rng.integers(2, 4))
    longest_s = (duration_s - REST_S[1]) / (periods + 1)
    period = round(rng.uniform(0.4, 1.0) * min(longest_s, 20.0) * rate_Hz)
    wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange((periods + 1) * period) / period)
    lead = begin.size + round(rng.uniform(0.1, 0.9) * period)
    return Commands(np.concatenate((begin, wave))[: lead + periods * period], lead)


def _random_walk(rng: np.random.Generator, rate_Hz: float, duration_s: float) -> Commands:
    """Random steps of the speed's sign and size, smoothed twice and stretched to the full range."""
    begin = rest(rng, rate_Hz, pace_of(duration_s))
    count = round(duration_s * rate_Hz) - begin.size
    approach = round(0.04 * count)
    knots = np.cumsum(rng.normal(0.0, 1.0, int(rng.integers(40, 150))))
    knots -= np.linspace(0.0, knots[-1], knots.size) * rng.uniform(0.5, 1.0)
    width = max(3, round((count - approach) / knots.size))
    walk = np.interp(np.linspace(0.0, knots.size - 1.0, count - approach + 2 * width), np.arange(knots.size), knots)
    for _ in range(2):
        sums = np.cumsum(np.concatenate(([0.0], walk)))
        walk = (sums[width:] - sums[:-width]) / width
    walk = walk[: count - approach]
    walk = (walk - walk.min()) / np.ptp(walk)
    return Commands(np.concatenate((begin, eased(0.0, float(walk[0]), approach), walk)), begin.size + approach)


IDENTIFICATIONS: dict[str, Draw] = {
    "triangles": _triangles,
    "staircase": _staircase,
    "decaying sine": _decaying_sine,
    "repeated sine": _repeated_sine,
    "random walk": _random_walk,
}
AMID = frozenset({"decaying sine", "repeated sine", "random walk"})
"""Kinds whose writing may begin amid the range."""
