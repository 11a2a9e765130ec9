"""The load cell of a concealed plant: leakage, low-pass, cross-talk, hum, delay and clock of the readings."""

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.linear import first_order, high_pass, respond, second_order
from firmware_sim.concealed.plant.record_context import RecordContext, Signal
from firmware_sim.concealed.plant.sampling import read_at, tone, wander


def samples(context: RecordContext, force: Signal, voltage: Signal) -> Array:
    """Readings without noise, shape (n,) [N].

    Parameters
    ----------
    context
        Commands, active effects, ranges and seed of the record.
    force
        True force on the load cell, on the fine grid [N].
    voltage
        Voltage at the stack, on the fine grid [V].
    """
    filtered = _low_pass(context, Signal(_leak(context, force), force.held))
    signal_N = _add_hum(context, _add_cross_talk(context, filtered.values, voltage.values))
    positions = context.drive.positions
    if on := context.on("clock_skew"):
        positions = positions * (1.0 + 1e-6 * on.parameters["skew_ppm"])
    if on := context.on("transport_delay"):
        positions = positions - on.parameters["delay_s"] / context.drive.fine_s
    return context.with_foreign("reading", read_at(signal_N, positions, held=filtered.held))


def _leak(context: RecordContext, force: Signal) -> Array:
    """Force behind the leaking charge amplifier [N]: `dy/dt = dF/dt - y / tau`; a held input stays held."""
    on = context.on("charge_leakage")
    if on is None:
        return force.values
    start_N = force.values[0]
    leaks = high_pass(on.parameters["time_constant_s"])
    result: Array = respond(leaks, force.values - start_N, context.drive.fine_s, held=force.held) + start_N
    return result


def _low_pass(context: RecordContext, force: Signal) -> Signal:
    """Force behind the low-pass [N]; the cutoff is at -3 dB."""
    on = context.on("sensor_filter")
    if on is None:
        return force
    cutoff_Hz, damping = on.parameters["cutoff_Hz"], on.number("damping_ratio")
    if on.number("order") < 2:
        low_pass = first_order(0.5 / np.pi / cutoff_Hz)
    else:
        # -3 dB: |1 - x^2 + 2 d x j| = sqrt(2) for the ratio x of cutoff and natural frequency.
        middle = 1.0 - 2.0 * damping**2
        low_pass = second_order(cutoff_Hz / (middle + (middle**2 + 1.0) ** 0.5) ** 0.5, damping)
    return Signal(respond(low_pass, force.values, context.drive.fine_s, held=force.held), held=False)


def _add_cross_talk(context: RecordContext, force_N: Array, voltage_V: Array) -> Array:
    """Add the cross-talk k du/dt [N]; the rate is the mean over a short window."""
    on = context.on("feedthrough")
    if on is None:
        return force_N
    steps = max(1, round(on.number("window_s") / context.drive.fine_s))
    before_V = np.concatenate((np.full(steps, voltage_V[0]), voltage_V[:-steps]))
    rate_V_per_s = (voltage_V - before_V) / (steps * context.drive.fine_s)
    result: Array = force_N + on.parameters["coefficient_N_s_per_V"] * rate_V_per_s
    return result


def _add_hum(context: RecordContext, force_N: Array) -> Array:
    """Add mains hum [N]: fundamental and harmonics whose phases wander together."""
    on = context.on("mains_hum")
    if on is None:
        return force_N
    time_s, rng = context.time_s(force_N.size), context.random("mains")
    harmonics = on.details["harmonics"]
    assert isinstance(harmonics, dict)
    phases = rng.uniform(0.0, 2.0 * np.pi, 8)
    stray = on.number("stray_rad") * wander(rng, time_s, on.number("stray_s"))
    wave = np.zeros(force_N.size)
    for order, part in {"1": 1.0, **harmonics}.items():
        n = int(order)
        wave += part * tone(time_s, n * on.parameters["frequency_Hz"], n * stray + phases[n])
    return force_N + on.parameters["amplitude_N"] * wave
