"""A measurement of the shipped model with noise, and a simulation of it from another program."""

import numpy as np

from piezod.commissioning.shipped_files import shipped
from piezod.model import load_model
from piezod.recording import Recording, write_recording

MODEL = shipped("model.yaml")


def white(seed, size=20_000):
    return np.random.default_rng(seed).standard_normal(size)


def write_measured_and_simulated(folder):
    """Write both files; returns their paths, the force of the model, and the noise of the measurement."""
    time_s = np.arange(4000) * 5e-3
    voltage_V = 60.0 - 50.0 * np.cos(2 * np.pi * 0.2 * time_s) - 10.0
    force_N = load_model(MODEL).operator().run(voltage_V)
    noise_N = 0.5 * white(9, voltage_V.size)
    measured, simulated = folder / "measured.csv", folder / "simulated.csv"
    write_recording(Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N + noise_N}), measured)
    write_recording(Recording(time_s[:3000:2], {"force_N": force_N[:3000:2] + 1.0}), simulated)
    return measured, simulated, force_N, noise_N
