"""Plants whose answers have a closed form, and the drives for them."""

import numpy as np

from firmware_sim.concealed.plant.chain import Plant
from firmware_sim.concealed.plant.drives import Drive
from firmware_sim.concealed.plant.force_law import ForceLaw
from firmware_sim.concealed.plant.hysteresis import Hysteresis, draw_noncongruent
from firmware_sim.concealed.plant.record_context import Effect
from firmware_sim.concealed.plant.stops import Stops

REACH_V, FULL_N, RATE_HZ = 100.0, 200.0, 1000.0


def straight_plant():
    """No hysteresis, force in proportion to the voltage: 2 N/V."""
    stops = Stops(np.array([10.0]), np.array([0.0]), 0.0)
    return _plant(Hysteresis("plays", stops, 1.0, 1.0, REACH_V))


def play_plant(width_V=10.0):
    """One play of a half width, and nothing else."""
    stops = Stops(np.array([width_V]), np.array([1.0]), 0.0)
    return _plant(Hysteresis("plays", stops, 1.0, 1.0, REACH_V))


def _plant(hysteresis):
    noncongruent = draw_noncongruent(np.random.default_rng(1), REACH_V)
    return Plant(hysteresis, noncongruent, ForceLaw(FULL_N, 0.0, 0.0))


def drive(voltage_V, rate_Hz=RATE_HZ, *, held=False, late=0.0, temperature_C=None):
    voltage_V = np.asarray(voltage_V, dtype=float)
    temperature_C = np.full(voltage_V.size, 23.0) if temperature_C is None else temperature_C
    return Drive(voltage_V, rate_Hz, held, late, temperature_C)


def effect(name, details=None, **parameters):
    return {name: Effect(name, parameters, details or {})}


def forces(plant, drive, seed=1, **effects):
    return plant.reading_N(drive, effects, seed)


def triangles(frequency_Hz, periods, peak_V=REACH_V, rate_Hz=RATE_HZ):
    phase = np.arange(round(periods * rate_Hz / frequency_Hz) + 1) * frequency_Hz / rate_Hz
    return peak_V * (1.0 - np.abs(1.0 - 2.0 * (phase % 1.0)))


def hold(voltage_V, duration_s, rate_Hz=RATE_HZ):
    return np.full(round(duration_s * rate_Hz), float(voltage_V))


def opening_percent(voltage_V, force_N, frequency_Hz, range_N, rate_Hz=RATE_HZ):
    """Mean distance of falling and rising branch in the middle of the last period, in percent of a range."""
    period = round(rate_Hz / frequency_Hz)
    u, f = voltage_V[-period - 1 :], force_N[-period - 1 :]
    half = period // 2
    grid = np.linspace(0.35, 0.65, 50) * voltage_V.max()
    up = np.interp(grid, u[: half + 1], f[: half + 1])
    down = np.interp(grid, u[half:][::-1], f[half:][::-1])
    return 100.0 * float(np.mean(down - up)) / range_N
