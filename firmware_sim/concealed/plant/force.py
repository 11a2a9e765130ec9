"""From the free stroke to the true force: force law, contact, friction, temperature, load, a mode, a machine nearby."""

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.friction import rub
from firmware_sim.concealed.plant.linear import cascade, first_order, respond, second_order
from firmware_sim.concealed.plant.mechanics import ForceLaw, amount_of, bend, contact
from firmware_sim.concealed.plant.passage import Passage, Signal
from firmware_sim.concealed.plant.reader import tone, wander


def true_force(at: Passage, law: ForceLaw, stroke: Signal) -> Signal:
    """Force on the load cell, on the fine grid [N]."""
    force_N = law(stroke.values / at.reach_V)
    force_N = at.with_foreign("force", _rubbed(at, _bent(at, force_N)))
    driving = Signal(_loaded(at, _warmed(at, force_N)), stroke.stairs)
    swinging = _swung(at, driving)
    return Signal(_vibrated(at, swinging.values), swinging.stairs)


def edge(time_s: Array, at_s: float, rise_s: float) -> Array:
    """Half a cosine wave from 0 to 1 within `rise_s`, shape (n,) (1)."""
    rise: Array = 0.5 - 0.5 * np.cos(np.pi * np.clip((time_s - at_s) / rise_s, 0.0, 1.0))
    return rise


def _bent(at: Passage, force_N: Array) -> Array:
    if on := at.on("output_nonlinearity"):
        amount = amount_of(on.parameters["curvature"], on.text("shape"))
        force_N = at.full_N * bend(force_N / at.full_N, amount, on.text("shape"))
    if on := at.on("contact_gap"):
        force_N = contact(force_N, on.parameters["gap_N"], on.number("softness_N"))
    return force_N


def _rubbed(at: Passage, force_N: Array) -> Array:
    on = at.on("friction")
    if on is None:
        return force_N
    given = on.parameters
    return force_N - rub(force_N, given["force_N"], given["presliding_N"], on.number("break_away"))


def _warmed(at: Passage, force_N: Array) -> Array:
    on = at.on("thermal_drift")
    if on is None:
        return force_N
    warmth_K = at.drive.fine(at.drive.temperature_C - at.drive.temperature_C[0])
    if on.number("lag_s") > 0.0:
        half = first_order(0.5 * on.number("lag_s"))
        warmth_K = respond(cascade(half, half), warmth_K, at.drive.fine_s, stairs=False)
    return force_N + on.parameters["coefficient_N_per_K"] * warmth_K


def _loaded(at: Passage, force_N: Array) -> Array:
    on = at.on("load_step")
    if on is None:
        return force_N
    time_s, rise_s = at.time_s(force_N.size), on.number("rise_s")
    there = edge(time_s, on.parameters["on_s"], rise_s)
    if "off_s" in on.parameters:
        there = there - edge(time_s, on.parameters["off_s"], rise_s)
    return force_N + on.parameters["step_N"] * there


def _swung(at: Passage, driving: Signal) -> Signal:
    on = at.on("resonance")
    if on is None:
        return driving
    mode = second_order(on.parameters["frequency_Hz"], on.parameters["damping_ratio"])
    return Signal(respond(mode, driving.values, at.drive.fine_s, stairs=driving.stairs), stairs=False)


def _vibrated(at: Passage, force_N: Array) -> Array:
    on = at.on("vibration")
    if on is None:
        return force_N
    time_s, rng = at.time_s(force_N.size), at.random("vibration")
    phase = rng.uniform(0.0, 2.0 * np.pi, 1)
    breath = 1.0 + on.number("breathing") * wander(rng, time_s, on.number("breath_s"))
    return force_N + on.parameters["amplitude_N"] * breath * tone(time_s, on.parameters["frequency_Hz"], phase)
