"""Voltage records and what is read off the answers to them."""

import numpy as np

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario

DT_S = 1e-3


def triangles(peaks_V, period_s=10.0, dt_s=DT_S):
    samples = round(period_s / dt_s)
    ramp = 1.0 - np.abs(1.0 - 2.0 * np.arange(samples) / samples)
    return np.concatenate([*(peak * ramp for peak in peaks_V), [0.0]])


def hold(voltage_V, duration_s, dt_s=DT_S):
    return np.full(round(duration_s / dt_s), float(voltage_V))


def branches(voltage_V, force_N):
    turns = np.flatnonzero(np.diff(np.sign(np.diff(voltage_V))) != 0) + 1
    for start, end in zip([0, *turns], [*turns, voltage_V.size - 1], strict=True):
        yield voltage_V[start : end + 1], force_N[start : end + 1]


def opening_percent(voltage_V, force_N):
    """100 max_u (greatest falling - least rising force) / range, over every branch of the record."""
    grid = np.linspace(1.0, voltage_V.max() - 1.0, 250)
    highest, lowest = np.full(grid.size, np.nan), np.full(grid.size, np.nan)
    for u, f in branches(voltage_V, force_N):
        rising = u[-1] > u[0]
        low, high = min(u[0], u[-1]), max(u[0], u[-1])
        values = np.interp(grid, u, f) if rising else np.interp(grid, u[::-1], f[::-1])
        values[(grid < low) | (grid > high)] = np.nan
        if rising:
            lowest = np.fmin(lowest, values)
        else:
            highest = np.fmax(highest, values)
    return 100.0 * np.nanmax(highest - lowest) / (force_N.max() - force_N.min())


def bench(*, seed=1, noise_N=0.0, **sections):
    """A bench of the scenario `stack` with sections replaced; without noise unless asked for."""
    sections.setdefault("load_cell", {})
    sections["load_cell"] = {"white_noise_N": noise_N, **sections["load_cell"]}
    return Bench(load_scenario("stack", sections), seed=seed)


def forces(voltage_V, *, dt_s=DT_S, seed=1, noise_N=0.0, interpolate=False, **effects):
    """Readings of the bench with these effects on."""
    return bench(seed=seed, noise_N=noise_N, effects=effects).run(voltage_V, dt_s, interpolate=interpolate)
