"""The amplifier: converter step, output range, current limit into the stack's capacitance, first-order lag.

The lag `tau du/dt = target - u` is integrated by the trapezoidal rule over the physics step, split where the step is
long against the time constant; the current limit bounds each part's change. There is no closed-form exponential here.
"""

import math

from numba import njit

from firmware_sim.physics.layout import STATUS_AMPLIFIER_FAULT, STATUS_MAINS_LOST, Record

_DEAD = STATUS_AMPLIFIER_FAULT | STATUS_MAINS_LOST


@njit(cache=True)
def watch_for_commands(state: Record, parameters: Record) -> None:
    """Let the dead-man's switch ramp the command to its safe value when no command has come for too long."""
    state.quiet_steps += 1
    if state.watchdog_steps > 0 and state.quiet_steps > state.watchdog_steps:
        state.tripped = 1
    if state.tripped == 0:
        return
    most_V = parameters.watchdog_ramp_V_per_s * parameters.step_s
    gap_V = parameters.safe_V - state.command_V
    state.command_V += min(max(gap_V, -most_V), most_V)


@njit(cache=True)
def drive(state: Record, parameters: Record) -> None:
    """Move the output voltage [V] by one physics step towards the command."""
    wanted_V = state.command_V if (state.fault_bits & _DEAD) == 0 else 0.0
    if parameters.converter_step_V > 0.0:
        wanted_V = parameters.converter_step_V * math.floor(wanted_V / parameters.converter_step_V + 0.5)
    state.target_V = min(max(wanted_V, parameters.minimum_V), parameters.maximum_V)
    state.clamped = 1 if state.target_V != wanted_V else 0
    state.previous_output_V = state.output_V
    if parameters.lag_s <= 0.0:
        most_V = _most(parameters, parameters.step_s)
        state.output_V += min(max(state.target_V - state.output_V, -most_V), most_V)
        return
    _lag(state, parameters)


@njit(cache=True)
def _lag(state: Record, parameters: Record) -> None:
    """Follow the target with the lag; a new target acts from the beginning of the step."""
    parts = min(64, 1 + int(4.0 * parameters.step_s / parameters.lag_s))
    part_s = parameters.step_s / parts
    most_V = _most(parameters, part_s)
    ratio = part_s / parameters.lag_s
    for _ in range(parts):
        change_V = ratio * (state.target_V - state.output_V) / (1.0 + 0.5 * ratio)
        state.output_V += min(max(change_V, -most_V), most_V)


@njit(cache=True)
def _most(parameters: Record, duration_s: float) -> float:
    """Return the greatest change of the output [V] in a time [s]; the limit 0 stands for none."""
    if parameters.slew_V_per_s > 0.0:
        limit_V: float = parameters.slew_V_per_s * duration_s
        return limit_V
    return math.inf
