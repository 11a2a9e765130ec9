"""The amplifier: watchdog ramp, converter step, output range, current limit and first-order lag.

The lag `tau du/dt = target - u` is integrated by the trapezoidal rule. A physics step that is long against tau is split
into parts. The current limit bounds the change within each part.
"""

import math

from numba import njit

from firmware_sim.physics.layout import OUTPUT_OFF_FAULTS, Record


@njit(cache=True)
def run_watchdog(state: Record, parameters: Record) -> None:
    """Count the steps without a command; after the timeout, ramp the command to its safe value.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    """
    state.steps_since_command += 1
    if state.watchdog_steps > 0 and state.steps_since_command > state.watchdog_steps:
        state.tripped = 1
    if state.tripped == 0:
        return
    most_V = parameters.watchdog_ramp_V_per_s * parameters.step_s
    gap_V = parameters.safe_V - state.command_V
    state.command_V += min(max(gap_V, -most_V), most_V)


@njit(cache=True)
def drive(state: Record, parameters: Record) -> None:
    """Move the output voltage [V] by one physics step towards the command.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    """
    input_V = state.command_V if (state.fault_bits & OUTPUT_OFF_FAULTS) == 0 else 0.0
    if parameters.converter_step_V > 0.0:
        input_V = parameters.converter_step_V * math.floor(input_V / parameters.converter_step_V + 0.5)
    state.target_V = min(max(input_V, parameters.minimum_V), parameters.maximum_V)
    state.clamped = 1 if state.target_V != input_V else 0
    state.previous_output_V = state.output_V
    if parameters.lag_s <= 0.0:
        most_V = _largest_change_V(parameters, parameters.step_s)
        state.output_V += min(max(state.target_V - state.output_V, -most_V), most_V)
        return
    _follow_with_lag(state, parameters)


@njit(cache=True)
def _follow_with_lag(state: Record, parameters: Record) -> None:
    """Move the output by one step of the lag; a new target acts from the beginning of the step."""
    parts = min(64, 1 + int(4.0 * parameters.step_s / parameters.lag_s))
    part_s = parameters.step_s / parts
    most_V = _largest_change_V(parameters, part_s)
    ratio = part_s / parameters.lag_s
    for _ in range(parts):
        change_V = ratio * (state.target_V - state.output_V) / (1.0 + 0.5 * ratio)
        state.output_V += min(max(change_V, -most_V), most_V)


@njit(cache=True)
def _largest_change_V(parameters: Record, duration_s: float) -> float:
    """Return the largest change of the output [V] within a duration [s]; a limit of 0 means no limit."""
    if parameters.slew_V_per_s > 0.0:
        limit_V: float = parameters.slew_V_per_s * duration_s
        return limit_V
    return math.inf
