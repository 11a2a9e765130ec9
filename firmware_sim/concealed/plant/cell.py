"""From the true force to the reader's samples: leakage, low-pass, cross-talk, hum, delay, the reader's clock."""

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.linear import first_order, high_pass, respond, second_order
from firmware_sim.concealed.plant.passage import Passage, Signal
from firmware_sim.concealed.plant.reader import read_at, tone, wander


def samples(at: Passage, force: Signal, voltage: Signal) -> Array:
    """Readings without noise, shape (n,) [N].

    Parameters
    ----------
    at
        The pass.
    force, voltage
        On the load cell [N], and at the stack [V].
    """
    filtered = _filtered(at, Signal(_leaked(at, force), force.stairs))
    signal_N = _hummed(at, _coupled(at, filtered.values, voltage.values))
    places = at.drive.places
    if on := at.on("clock_skew"):
        places = places * (1.0 + 1e-6 * on.parameters["skew_ppm"])
    if on := at.on("transport_delay"):
        places = places - on.parameters["delay_s"] / at.drive.fine_s
    return at.with_foreign("reading", read_at(signal_N, places, stairs=filtered.stairs))


def _leaked(at: Passage, force: Signal) -> Array:
    """Leak; what is fast passes as it came, so that a staircase stays one."""
    on = at.on("charge_leakage")
    if on is None:
        return force.values
    start_N = force.values[0]
    leaks = high_pass(on.parameters["time_constant_s"])
    result: Array = respond(leaks, force.values - start_N, at.drive.fine_s, stairs=force.stairs) + start_N
    return result


def _filtered(at: Passage, force: Signal) -> Signal:
    on = at.on("sensor_filter")
    if on is None:
        return force
    cutoff_Hz, damping = on.parameters["cutoff_Hz"], on.number("damping_ratio")
    if on.number("order") < 2:
        low_pass = first_order(0.5 / np.pi / cutoff_Hz)
    else:
        # Where |1 - x^2 + 2 d x j| is the root of 2.
        middle = 1.0 - 2.0 * damping**2
        low_pass = second_order(cutoff_Hz / (middle + (middle**2 + 1.0) ** 0.5) ** 0.5, damping)
    return Signal(respond(low_pass, force.values, at.drive.fine_s, stairs=force.stairs), stairs=False)


def _coupled(at: Passage, force_N: Array, voltage_V: Array) -> Array:
    """Add what the drive's mean rate over a short window couples in."""
    on = at.on("feedthrough")
    if on is None:
        return force_N
    steps = max(1, round(on.number("window_s") / at.drive.fine_s))
    before_V = np.concatenate((np.full(steps, voltage_V[0]), voltage_V[:-steps]))
    rate_V_per_s = (voltage_V - before_V) / (steps * at.drive.fine_s)
    result: Array = force_N + on.parameters["coefficient_N_s_per_V"] * rate_V_per_s
    return result


def _hummed(at: Passage, force_N: Array) -> Array:
    on = at.on("mains_hum")
    if on is None:
        return force_N
    time_s, rng = at.time_s(force_N.size), at.random("mains")
    harmonics = on.details["harmonics"]
    assert isinstance(harmonics, dict)
    phases = rng.uniform(0.0, 2.0 * np.pi, 8)
    stray = on.number("stray_rad") * wander(rng, time_s, on.number("stray_s"))
    wave = np.zeros(force_N.size)
    for order, part in {"1": 1.0, **harmonics}.items():
        n = int(order)
        wave += part * tone(time_s, n * on.parameters["frequency_Hz"], n * stray + phases[n])
    return force_N + on.parameters["amplitude_N"] * wave
