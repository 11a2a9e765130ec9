"""The piezo stack: from voltage to free stroke, expressed in volts.

- Rate dependence: the relays see the voltage less a coercive offset. The offset grows with ln(1 + rate / reference). It
  builds up over the path travelled [V], not over time, so that nothing moves while the voltage rests.
- Creep: relaxations `tau dx/dt = w h - x` of the output h of the hysteresis, evenly spaced in log(tau). The step
  response rises with the logarithm of time. Integrated by the trapezoidal rule.
- Ageing: the gain of the stroke approaches its end value exponentially.

All are derived here; the hysteresis stands in `preisach.py`.
"""

import math

from numba import njit

from firmware_sim.physics.layout import Record
from firmware_sim.physics.preisach import move_field


@njit(cache=True)
def deform(state: Record, parameters: Record) -> None:
    """Advance the free stroke [V] by one physics step under the amplifier's output.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    """
    _advance_coercive_offset(state, parameters)
    move_field(state, parameters, state.output_V - state.coercive_V)
    state.previous_hysteresis = state.hysteresis
    state.hysteresis = parameters.reversible * state.output_V + state.irreversible
    state.stroke = state.hysteresis
    if parameters.creep_modes > 0:
        _advance_creep(state, parameters)
    if parameters.gain_change != 0.0:
        age = state.steps * parameters.step_s / parameters.gain_time_s
        state.stroke *= 1.0 - parameters.gain_change * math.expm1(-age) / (1.0 - math.exp(-1.0))


@njit(cache=True)
def _advance_coercive_offset(state: Record, parameters: Record) -> None:
    """Move the coercive offset towards its value at the present rate."""
    travel_V = state.output_V - state.previous_output_V
    if parameters.rate_growth == 0.0 or travel_V == 0.0:
        return
    rate = abs(travel_V) / parameters.step_s / parameters.rate_reference_V_per_s
    offset_V = parameters.rate_growth * parameters.width_scale_V * math.log1p(rate)
    path = abs(travel_V) / (parameters.rate_path_V + 3.0 * offset_V)
    parts = 1 + int(4.0 * path)
    for _ in range(parts):  # a midpoint step longer than the path would overshoot
        gap_V = math.copysign(offset_V, travel_V) - state.coercive_V
        state.coercive_V += gap_V * (path / parts) / (1.0 + 0.5 * path / parts)


@njit(cache=True)
def _advance_creep(state: Record, parameters: Record) -> None:
    """Move every relaxation towards its share of the hysteresis output, and add them to the stroke."""
    middle = 0.5 * (state.previous_hysteresis + state.hysteresis)
    total = 0.0
    for mode in range(parameters.creep_modes):
        half = 0.5 * parameters.step_s / parameters.creep_tau_s[mode]
        goal = parameters.creep_weight[mode] * middle
        state.creep[mode] = (state.creep[mode] * (1.0 - half) + 2.0 * half * goal) / (1.0 + half)
        total += state.creep[mode]
    state.stroke += total
