"""From the free stroke to the true force: force law, contact, friction, temperature, load step, mode, vibration."""

import numpy as np

from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.force_law import ForceLaw, amount_for_curvature, bend, contact
from firmware_sim.concealed.plant.friction import friction_force, lugre_friction, maxwell_slip
from firmware_sim.concealed.plant.linear import cascade, first_order, respond, second_order
from firmware_sim.concealed.plant.record_context import RecordContext, Signal
from firmware_sim.concealed.plant.sampling import tone, wander


def true_force(context: RecordContext, law: ForceLaw, stroke: Signal) -> Signal:
    """Force on the load cell, on the fine grid [N].

    Parameters
    ----------
    context
        Drive and active effects of the record.
    stroke
        Free stroke, on the fine grid [V].
    """
    force_N = law(stroke.values / context.reach_V)
    force_N = _subtract_friction(context, _bend_and_contact(context, force_N))
    force_N = context.with_foreign("force", force_N)
    driving = Signal(_add_load(context, _add_thermal_drift(context, force_N)), stroke.held)
    behind_mode = _resonate(context, driving)
    return Signal(_add_vibration(context, behind_mode.values), behind_mode.held)


def edge(time_s: Array, at_s: float, rise_s: float) -> Array:
    """Rise from 0 to 1 within `rise_s`, half a cosine wave, shape (n,) (1).

    Parameters
    ----------
    time_s
        Times, shape (n,) [s].
    at_s
        Begin of the rise [s].
    rise_s
        Duration of the rise [s], above 0.
    """
    rise: Array = 0.5 - 0.5 * np.cos(np.pi * np.clip((time_s - at_s) / rise_s, 0.0, 1.0))
    return rise


def _bend_and_contact(context: RecordContext, force_N: Array) -> Array:
    """Force behind the output nonlinearity and the contact gap [N]."""
    if on := context.on("output_nonlinearity"):
        amount = amount_for_curvature(on.parameters["curvature"], on.text("shape"))
        force_N = context.full_N * bend(force_N / context.full_N, amount, on.text("shape"))
    if on := context.on("contact_gap"):
        force_N = contact(force_N, on.parameters["gap_N"], on.number("softness_N"))
    return force_N


def _subtract_friction(context: RecordContext, force_N: Array) -> Array:
    """Force less the friction, or with it where the load cell stands in front of the guide [N]."""
    on = context.on("friction")
    if on is None:
        return force_N
    given, law = (on.parameters["force_N"], on.parameters["presliding_N"]), on.details.get("law", "elasto_plastic")
    if law == "maxwell":
        friction_N = maxwell_slip(force_N, *given, int(on.number("seed")))
    elif law == "lugre":
        fine_s = context.drive.fine_s
        friction_N = lugre_friction(force_N, *given, on.number("static"), on.number("slow_N_per_s"), fine_s)
    else:
        friction_N = friction_force(force_N, *given, on.number("break_away"))
    return force_N + friction_N if on.details.get("in_front") else force_N - friction_N


def _add_thermal_drift(context: RecordContext, force_N: Array) -> Array:
    """Add the thermal force [N]; it follows the temperature behind two equal lags."""
    on = context.on("thermal_drift")
    if on is None:
        return force_N
    warmth_K = context.drive.fine(context.drive.temperature_C - context.drive.temperature_C[0])
    if on.number("lag_s") > 0.0:
        half = first_order(0.5 * on.number("lag_s"))
        warmth_K = respond(cascade(half, half), warmth_K, context.drive.fine_s, held=False)
    return force_N + on.parameters["coefficient_N_per_K"] * warmth_K


def _add_load(context: RecordContext, force_N: Array) -> Array:
    """Add the load step [N]."""
    on = context.on("load_step")
    if on is None:
        return force_N
    time_s, rise_s = context.time_s(force_N.size), on.number("rise_s")
    applied = edge(time_s, on.parameters["on_s"], rise_s)
    if "off_s" in on.parameters:
        applied = applied - edge(time_s, on.parameters["off_s"], rise_s)
    return force_N + on.parameters["step_N"] * applied


def _resonate(context: RecordContext, driving: Signal) -> Signal:
    """Force behind the second-order mode [N]."""
    on = context.on("resonance")
    if on is None:
        return driving
    mode = second_order(on.parameters["frequency_Hz"], on.parameters["damping_ratio"])
    return Signal(respond(mode, driving.values, context.drive.fine_s, held=driving.held), held=False)


def _add_vibration(context: RecordContext, force_N: Array) -> Array:
    """Add the vibration [N]; its amplitude is modulated by a slow random walk."""
    on = context.on("vibration")
    if on is None:
        return force_N
    time_s, rng = context.time_s(force_N.size), context.random("vibration")
    phase = rng.uniform(0.0, 2.0 * np.pi, 1)
    envelope = 1.0 + on.number("breathing") * wander(rng, time_s, on.number("breath_s"))
    return force_N + on.parameters["amplitude_N"] * envelope * tone(time_s, on.parameters["frequency_Hz"], phase)
