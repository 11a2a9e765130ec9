"""Recordings made by hand: a drive, a straight model, noise of a colour, and what may be missing from the model."""

import numpy as np
from scipy.signal import lfilter

from piezod.estimation.recordings.converter import converter_step_N
from piezod.estimation.recordings.series import Series

RATE_HZ = 1000.0
GAIN_N_PER_V = 1.8


def time(samples, rate_Hz=RATE_HZ):
    return np.arange(samples) / rate_Hz


def mixed_work(time_s):
    """A slow swing with faster ones that come and go, and two holds, without jumps, within 0 to 120 V."""
    holds = sum((time_s > part * time_s[-1]) & (time_s < (part + 0.06) * time_s[-1]) for part in (0.4, 0.7))
    own_s = np.cumsum(1.0 - holds) * (time_s[1] - time_s[0])
    u = 55.0 + 25.0 * np.sin(2.0 * np.pi * 0.11 * own_s)
    for k, frequency_Hz in enumerate((0.37, 1.3, 3.1, 7.7, 17.3)):
        on = np.clip(3.0 * np.sin(2.0 * np.pi * (0.013 + 0.007 * k) * own_s + k) + 1.0, 0.0, 1.0)
        u += 7.0 * on * np.sin(2.0 * np.pi * frequency_Hz * own_s + k)
    return np.clip(u, 0.0, 120.0)


def triangles(time_s, frequency_Hz=0.25):
    return 120.0 * np.abs((2.0 * frequency_Hz * time_s) % 2.0 - 1.0)


def model_of(u):
    return GAIN_N_PER_V * u


def noise(samples, rho, rng):
    """First-order autoregressive, standard deviation 1."""
    if rho == 0.0:
        return rng.standard_normal(samples)
    white = rng.standard_normal(samples + 2000)
    return lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white)[2000:]


def series(time_s, u, reading_N, noise_N=1.0, *, counts=None, temperature_C=None, role="recording", start_s=0.0):
    counts = np.ones(time_s.size, bool) if counts is None else counts
    more = {"temperature_C": temperature_C, "start_s": start_s, "lattice_N": converter_step_N(reading_N[counts])}
    return Series("by hand", role, time_s, u, reading_N, counts, noise_N, **more)


def lagged(values, tau_s, rate_Hz=RATE_HZ):
    keep = np.exp(-1.0 / (tau_s * rate_Hz))
    return values[0] + lfilter([1.0 - keep], [1.0, -keep], values - values[0])


def crept(values, rate_Hz=RATE_HZ):
    """What a solid with six fading times from 30 ms to 10 s lacks of its final value."""
    return sum(lagged(values, tau_s, rate_Hz) - values for tau_s in np.geomspace(0.03, 10.0, 6))


def played(values, width):
    out, state = np.empty_like(values), values[0]
    for k, value in enumerate(values):
        state = max(value - width, min(value + width, state))
        out[k] = state
    return out


def yielded(force_N, limit_N, hardening=0.3):
    """Permanent set of a spring that yields above a force, and hardens with it."""
    out, most = np.empty_like(force_N), limit_N
    for k, force in enumerate(force_N):
        most = max(most, force)
        out[k] = hardening * (most - limit_N)
    return out


def swapped(values, places):
    out = values.copy()
    for k in places:
        out[k], out[k + 3] = values[k + 3], values[k]
    return out
