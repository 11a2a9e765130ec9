"""The mechanics between stack and load cell: force law, contact, friction, one mode, external forces.

- Force law: `F = F_full x (1 + a x^2) / (1 + b x)`, scaled to F_full at full stroke x = 1. It stiffens (a) and
  saturates (b). Chosen here.
- Output nonlinearity of curvature k: `F_full (exp(2 k x) - 1) / (2 k)`; it bends up for k > 0, down for k < 0.
- Contact: `e^2 / (e + h)` of the excess e = F - gap > 0, with the softness h of rough faces. Chosen here.
- Friction: `dz/dx = s (1 - z sgn(dx) / z_max)` by the midpoint rule. Source: Dahl (1968), A solid friction model.
- Mode: `F'' + 2 d w F' + w^2 F = w^2 F_in`, fourth-order Runge-Kutta in parts that are short against the period.
"""

import math

from numba import njit

from firmware_sim.physics.layout import Record


@njit(cache=True)
def load(state: Record, parameters: Record) -> None:
    """Advance the true force [N] on the load cell by one physics step.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    """
    state.previous_contact_N = state.contact_N
    state.contact_N = _contact(parameters, _force_law(parameters, state.stroke / parameters.full_V))
    before_N = state.drive_N
    state.drive_N = state.contact_N
    if parameters.friction_N > 0.0:
        _advance_friction(state, parameters)
        state.drive_N -= state.friction_N
    _add_external_forces(state, parameters)
    if parameters.mode_rad_per_s > 0.0:
        _advance_mode(state, parameters, before_N)
    else:
        state.mode_N = state.drive_N
    state.true_force_N = state.mode_N - parameters.tare_N


@njit(cache=True)
def _force_law(parameters: Record, stroke: float) -> float:
    """Return the force [N] at a relative stroke."""
    law = stroke * (1.0 + parameters.stiffening * stroke * stroke) / (1.0 + parameters.softening * stroke)
    law *= (1.0 + parameters.softening) / (1.0 + parameters.stiffening)
    bend = 2.0 * parameters.curvature
    if bend != 0.0:
        law = math.expm1(bend * law) / bend
    force_N: float = parameters.full_N * law
    return force_N


@njit(cache=True)
def _contact(parameters: Record, force_N: float) -> float:
    """Return the force [N] that arrives behind a gap of `gap_N`."""
    if parameters.gap_N <= 0.0:
        return force_N
    excess_N: float = force_N - parameters.gap_N
    if excess_N <= 0.0:
        return 0.0
    arrives_N: float = excess_N * excess_N / (excess_N + parameters.touch_N)
    return arrives_N


@njit(cache=True)
def _advance_friction(state: Record, parameters: Record) -> None:
    """Advance the friction [N]; the motion is measured in contact force."""
    travel = state.contact_N - state.previous_contact_N
    if travel == 0.0:
        return
    parts = 1 + int(4.0 * abs(travel) / parameters.presliding_N)
    ratio = abs(travel) / parameters.presliding_N / parts
    for _ in range(parts):  # a midpoint step longer than the presliding travel would overshoot
        gap_N = math.copysign(parameters.friction_N, travel) - state.friction_N
        state.friction_N += gap_N * ratio / (1.0 + 0.5 * ratio)


@njit(cache=True)
def _add_external_forces(state: Record, parameters: Record) -> None:
    """Add thermal force, load step and vibration to the driving force [N]."""
    time_s = state.steps * parameters.step_s
    if parameters.drift_N_per_K != 0.0:
        state.drive_N += parameters.drift_N_per_K * (state.temperature_C - parameters.mean_degC)
    if parameters.load_N != 0.0:
        applied_N = parameters.load_N if parameters.load_on_s <= time_s < parameters.load_off_s else 0.0
        state.load_N += (
            (applied_N - state.load_N) * parameters.step_s / (parameters.load_rise_s + 0.5 * parameters.step_s)
        )
        state.drive_N += state.load_N
    if parameters.vibration_N != 0.0:
        phase = parameters.vibration_rad_per_s * time_s + parameters.vibration_phase
        envelope = 1.0 + parameters.vibration_breathing * math.sin(0.013 * phase)
        state.drive_N += parameters.vibration_N * envelope * math.sin(phase)


@njit(cache=True)
def _advance_mode(state: Record, parameters: Record, before_N: float) -> None:
    """Advance the mode by one step; its input runs linearly from `before_N` to `state.drive_N`."""
    parts = 1 + int(5.0 * parameters.mode_rad_per_s * parameters.step_s)
    part_s = parameters.step_s / parts
    slope_N = (state.drive_N - before_N) / parts
    for part in range(parts):
        start_N = before_N + part * slope_N
        _runge_kutta(state, parameters, part_s, start_N, start_N + slope_N)


@njit(cache=True)
def _runge_kutta(state: Record, parameters: Record, part_s: float, start_N: float, end_N: float) -> None:
    """Take one classical fourth-order step of the mode."""
    square = parameters.mode_rad_per_s * parameters.mode_rad_per_s
    loss = 2.0 * parameters.mode_damping * parameters.mode_rad_per_s
    middle_N = 0.5 * (start_N + end_N)
    x, v = state.mode_N, state.mode_N_per_s
    a1 = square * (start_N - x) - loss * v
    v2 = v + 0.5 * part_s * a1
    a2 = square * (middle_N - x - 0.5 * part_s * v) - loss * v2
    v3 = v + 0.5 * part_s * a2
    a3 = square * (middle_N - x - 0.5 * part_s * v2) - loss * v3
    v4 = v + part_s * a3
    a4 = square * (end_N - x - part_s * v3) - loss * v4
    state.mode_N = x + part_s * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
    state.mode_N_per_s = v + part_s * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
