"""A stack of eight plays with creep, a delay and a gain, written without the package: a bench through several years."""

from pathlib import Path

import numpy as np

RATE_HZ = 200.0
NOISE_N = 0.05
THRESHOLDS_V = np.array([1.0, 2.5, 5.0, 8.0, 12.0, 17.0, 25.0, 35.0])
WEIGHTS = np.array([0.06, 0.05, 0.06, 0.05, 0.05, 0.04, 0.04, 0.03])  # N/V
TIMES_S = np.geomspace(0.1, 100.0, 16)  # of the creep


def read(voltage_V, seed, *, creep_per_decade=0.0, late=0, gain=1.0, hum_N=0.0):
    """Readings [N]: `creep_per_decade` of the stroke [1], `late` samples, `gain` [1], and mains hum of 50 Hz."""
    plays, stroke = np.zeros(THRESHOLDS_V.size), np.empty(voltage_V.size)
    for k, now in enumerate(voltage_V):
        plays = np.clip(plays, now - THRESHOLDS_V, now + THRESHOLDS_V)
        stroke[k] = 0.6 * now + WEIGHTS @ plays
    behind, crept = np.zeros(TIMES_S.size), np.empty(stroke.size)
    share, nearer = creep_per_decade * 3.0 / TIMES_S.size, 1.0 - np.exp(-1.0 / (RATE_HZ * TIMES_S))
    for k, now in enumerate(stroke):
        behind += nearer * (now - stroke[0] - behind)
        crept[k] = now + share * behind.sum()
    force_N = gain * np.concatenate((np.full(late, crept[0]), crept))[: crept.size]
    force_N += hum_N * np.sin(2 * np.pi * 50.0 * np.arange(force_N.size) / RATE_HZ + seed)
    return force_N + np.random.default_rng(seed).normal(0.0, NOISE_N, force_N.size)


def triangles(peaks_V):
    """Triangles from zero, a second each branch [V]."""
    size = round(RATE_HZ)
    branches = [part for peak in peaks_V for part in (np.linspace(0, peak, size), np.linspace(peak, 0, size))]
    return np.concatenate([np.zeros(20), *branches])


def work(seed, duration_s=30.0):
    """Sines, triangles, steps and ramps in an order drawn from a seed [V]."""
    rng = np.random.default_rng(seed)
    parts = [np.zeros(50)]
    while sum(map(len, parts)) < duration_s * RATE_HZ:
        time_s = np.arange(round(rng.uniform(1.5, 3.0) * RATE_HZ)) / RATE_HZ
        reach, middle, kind = rng.uniform(10.0, 45.0), rng.uniform(45.0, 55.0), rng.integers(4)
        phase = 10.0 ** rng.uniform(-0.3, 0.7) * time_s
        shapes = (
            middle - reach * np.cos(2 * np.pi * phase),
            middle + reach * (4 * np.abs(phase % 1 - 0.5) - 1),
            np.repeat(rng.uniform(5.0, 95.0, 5), time_s.size // 5),
            np.interp(time_s, np.linspace(0, time_s[-1], 6), rng.uniform(2.0, 98.0, 6)),
        )
        parts += [np.linspace(parts[-1][-1], shapes[kind][0], 40), shapes[kind]]
    return np.concatenate(parts)[: round(duration_s * RATE_HZ)]


def record(path: Path, voltage_V, seed, **state):
    """Write a recording of the bench in a state."""
    columns = np.column_stack((np.arange(voltage_V.size) / RATE_HZ, voltage_V, read(voltage_V, seed, **state)))
    np.savetxt(path, columns, "%.6f", ",", header="time_s,voltage_V,force_N", comments="")
    return path
