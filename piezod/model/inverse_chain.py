"""The compiled steps of the chain with effects: one plans a voltage, one commits the voltage that was written.

    plan      force -> less thermal drift -> gap -> curved law -> force law -> gain -> creep -> plays at this rate
              -> lag -> output stage
    commit    output stage -> slew limit -> lag -> rate -> plays -> creep

A tick holds its command. The planned force is reached at the end of the tick, and the next reading shows it. Arrays:
`packed` is the operator's array, `chain` that of `chain_array`; both hold constants and states.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.effects.contact_gap import contact_step
from piezod.effects.kernels import first_order_coefficients, first_order_step, time_constant_at
from piezod.effects.output_nonlinearity import law_step
from piezod.effects.rate_dependent_hysteresis import OFFSET, POWER, rate_step
from piezod.effects.slew_limit import slew_step
from piezod.effects.voltage_clamp import clamp_step
from piezod.model.chain_array import CONSTANT, FIRST_ELEMENT, STATE
from piezod.operators.dead_zone import dead_zone_step
from piezod.operators.play import play_solve, play_step, play_value, play_wider_solve, play_wider_step
from piezod.operators.prandtl_ishlinskii import HEADER

Array = NDArray[np.float64]

MOST_PASSES, SAME_V = 40, 1e-9  # of the iteration for the voltage, whose rate widens the plays
BISECTIONS = 60


@numba.njit(cache=True)
def _widening(chain: Array, applied_V: float) -> tuple[float, float, float, float]:
    """Factor and offset [V] of the thresholds for a tick that ends at `applied_V`; its rate [V/s] and rest [s]."""
    moved_V = abs(applied_V - chain[STATE.applied_V])
    before, rested_s = chain[STATE.rate_V_per_s], chain[STATE.rested_s]
    way_V, memory_s = chain[CONSTANT.rate_way_V], chain[CONSTANT.rate_memory_s]
    rate, rested_s = rate_step(before, rested_s, moved_V, chain[CONSTANT.dt_s], way_V, memory_s)
    wider = chain[CONSTANT.rate_growth] * math.log1p(rate / chain[CONSTANT.rate_reference_V_per_s])
    if chain[CONSTANT.rate_kind] == OFFSET:
        return 1.0, chain[CONSTANT.rate_offset_V] * wider, rate, rested_s
    return (math.exp(wider) if chain[CONSTANT.rate_kind] == POWER else 1.0 + wider), 0.0, rate, rested_s


@numba.njit(cache=True)
def _invert_gap(force: float, gap: float, soft: float) -> float:
    """Force before the gap for the force `force` behind it [N]; without force, the begin of contact."""
    soft = min(soft, gap)
    if force <= 0.0:
        return gap - soft
    if force < soft:
        return gap + 2.0 * math.sqrt(force * soft) - soft
    return gap + force


@numba.njit(cache=True)
def _law(chain: Array, part: float) -> float:
    """Curved law of a force in parts of its span."""
    square, cube = chain[CONSTANT.law_square], chain[CONSTANT.law_cube]
    result: float = law_step(part, square, cube, chain[CONSTANT.law_low], chain[CONSTANT.law_high])
    return result


@numba.njit(cache=True)
def _invert_law(chain: Array, force: float) -> float:
    """Argument at which the curved law gives `force` [N], by bisection of the rising function."""
    span = chain[CONSTANT.law_span_N]
    aim = force / span
    low, high = aim - 1.0, aim + 1.0
    while _law(chain, low) > aim:
        low -= 2.0 * (high - low)
    while _law(chain, high) < aim:
        high += 2.0 * (high - low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _law(chain, middle) < aim:
            low = middle
        else:
            high = middle
    result: float = 0.5 * (low + high) * span
    return result


@numba.njit(cache=True)
def _creep(chain: Array) -> tuple[float, float]:
    """Output of the creep at the end of a tick: a constant [V], and a share per volt of its drive [1]."""
    constant, share, before_V = 0.0, 0.0, chain[STATE.creep_drive_V]
    count = (chain.size - FIRST_ELEMENT) // 4
    for j in range(FIRST_ELEMENT, FIRST_ELEMENT + count):
        keep, ramp, weight, state = chain[j], chain[j + count], chain[j + 2 * count], chain[j + 3 * count]
        constant += weight * first_order_step(state, before_V, 0.0, keep, ramp)
        share += weight * ramp
    return constant, share


@numba.njit(cache=True)
def plan_chain_step(packed: Array, chain: Array, force: float) -> float:
    """Voltage [V] that gives the force `force` [N] at the end of the tick; changes no state.

    Parameters
    ----------
    packed
        Packed array of an `ImplicitInverse`.
    chain
        Array of `chain_array`.
    force
        Force to reach [N].
    """
    plays, zones = int(packed[0]), int(packed[1])
    force -= chain[STATE.thermal_N]
    if chain[CONSTANT.gap_N] > 0.0:
        force = _invert_gap(force, chain[CONSTANT.gap_N], chain[CONSTANT.gap_softness_N])
    if chain[CONSTANT.law_span_N] > 0.0:
        force = _invert_law(chain, force)
    stroke_V = dead_zone_step(packed, HEADER + 3 * plays, zones, force - packed[2]) / chain[CONSTANT.gain]
    constant, share = _creep(chain)
    ratio = chain[CONSTANT.creep_drive_per_V]
    if ratio > 0.0:  # driven by the voltage: the voltage of the last tick is the first guess
        drive_V = ratio * (chain[STATE.applied_V] - chain[STATE.start_V])
        v = stroke_V - constant - share * drive_V
    else:
        v = (stroke_V - constant + share * chain[STATE.start_stroke_V]) / (1.0 + share)
    applied_V = _invert_plays(packed, chain, plays, v)
    if ratio > 0.0 and share > 0.0:
        drive_V = ratio * (applied_V - chain[STATE.start_V])
        applied_V = _invert_plays(packed, chain, plays, stroke_V - constant - share * drive_V)
    if chain[CONSTANT.lag_s] > 0.0:
        keep, _ = _lag(chain, 1.0)
        applied_V = chain[STATE.applied_V] + (applied_V - chain[STATE.applied_V]) / (1.0 - keep)
    return _invert_clamp(applied_V, chain[CONSTANT.clamp_limit_V], chain[CONSTANT.clamp_knee_V])


@numba.njit(cache=True)
def _lag(chain: Array, hold: float) -> tuple[float, float]:
    """`keep` and `ramp` of the lag at the present voltage of the stack."""
    tau_s = time_constant_at(chain[STATE.applied_V], chain[CONSTANT.lag_s], chain[CONSTANT.lag_swell])
    keep, ramp = first_order_coefficients(tau_s, chain[CONSTANT.dt_s], hold)
    return keep, ramp


@numba.njit(cache=True)
def _invert_plays(packed: Array, chain: Array, plays: int, v: float) -> float:
    """Voltage at which the plays give `v` [V]; iterated where the rate of the tick widens them."""
    if chain[CONSTANT.rate_growth] == 0.0:
        return play_solve(packed, HEADER, plays, v)
    applied_V: float = chain[STATE.applied_V]
    for _ in range(MOST_PASSES):
        factor, more, _, _ = _widening(chain, applied_V)
        before_V, applied_V = applied_V, play_wider_solve(packed, HEADER, plays, v, factor, more)
        if abs(applied_V - before_V) < SAME_V:
            return before_V  # the voltage that belongs to these thresholds: a resting voltage has another rate
    return applied_V


@numba.njit(cache=True)
def _invert_clamp(voltage_V: float, limit_V: float, knee_V: float) -> float:
    """Command at which the output stage gives `voltage_V` [V]; beyond its limit, the command that just reaches it."""
    inside = voltage_V - (limit_V - knee_V)
    if inside <= 0.0:
        return voltage_V
    if inside >= knee_V:
        return limit_V + knee_V
    return limit_V + knee_V - 2.0 * math.sqrt(knee_V * (knee_V - inside))


@numba.njit(cache=True)
def commit_chain_step(packed: Array, chain: Array, voltage_V: float) -> None:
    """Advance every state by a tick in which `voltage_V` [V] was written.

    Parameters
    ----------
    packed, chain
        As in `plan_chain_step`; their states change.
    voltage_V
        Voltage that was written [V].
    """
    plays = int(packed[0])
    given_V = clamp_step(voltage_V, chain[CONSTANT.clamp_limit_V], chain[CONSTANT.clamp_knee_V])
    before_V, applied_V = chain[STATE.slewed_V], chain[STATE.applied_V]
    slewed_V = slew_step(before_V, given_V, given_V, chain[CONSTANT.slew_V]) if given_V != before_V else given_V
    chain[STATE.slewed_V] = slewed_V
    if chain[CONSTANT.lag_s] > 0.0:
        keep, ramp = _lag(chain, 0.0 if slewed_V != given_V else 1.0)  # a voltage at the slew limit runs straight
        applied_V = first_order_step(applied_V, before_V, slewed_V, keep, ramp)
    else:
        applied_V = slewed_V
    if chain[CONSTANT.rate_growth] > 0.0:
        factor, more, rate, rested_s = _widening(chain, applied_V)
        chain[STATE.rate_V_per_s], chain[STATE.rested_s] = rate, rested_s
        v = play_wider_step(packed, HEADER, plays, applied_V, factor, more)
    else:
        v = play_step(packed, HEADER, plays, applied_V)
    chain[STATE.applied_V] = applied_V
    ratio = chain[CONSTANT.creep_drive_per_V]
    drive_V = ratio * (applied_V - chain[STATE.start_V]) if ratio > 0.0 else v - chain[STATE.start_stroke_V]
    before_V, chain[STATE.creep_drive_V] = chain[STATE.creep_drive_V], drive_V
    count = (chain.size - FIRST_ELEMENT) // 4
    for j in range(FIRST_ELEMENT, FIRST_ELEMENT + count):
        state = j + 3 * count
        chain[state] = first_order_step(chain[state], before_V, drive_V, chain[j], chain[j + count])


@numba.njit(cache=True)
def start_chain(packed: Array, chain: Array) -> None:
    """Set the states to rest at the present states of the plays.

    Parameters
    ----------
    packed, chain
        As in `plan_chain_step`; the states of `chain` change.
    """
    plays = int(packed[0])
    voltage_V = packed[HEADER + 2 * plays]  # the play with threshold 0 equals its input
    chain[STATE.slewed_V] = chain[STATE.applied_V] = chain[STATE.start_V] = voltage_V
    chain[STATE.start_stroke_V] = play_value(packed, HEADER, plays)
    chain[STATE.rate_V_per_s] = chain[STATE.rested_s] = chain[STATE.creep_drive_V] = chain[STATE.thermal_N] = 0.0
    count = (chain.size - FIRST_ELEMENT) // 4
    chain[FIRST_ELEMENT + 3 * count :] = 0.0


@numba.njit(cache=True)
def force_of(packed: Array, chain: Array, zones: Array) -> float:
    """Force before the resonance at the end of the tick committed last [N].

    Parameters
    ----------
    packed, chain
        Arrays of `ExtendedCompensator`.
    zones
        Thresholds, then weights, of the direct dead zones.
    """
    stroke_V = play_value(packed, HEADER, int(packed[0]))
    count = (chain.size - FIRST_ELEMENT) // 4
    for j in range(FIRST_ELEMENT, FIRST_ELEMENT + count):
        stroke_V += chain[j + 2 * count] * chain[j + 3 * count]
    force: float = dead_zone_step(zones, 0, zones.size // 2, chain[CONSTANT.gain] * stroke_V) + packed[2]
    span = chain[CONSTANT.law_span_N]
    if span > 0.0:
        square, cube = chain[CONSTANT.law_square], chain[CONSTANT.law_cube]
        force = span * law_step(force / span, square, cube, chain[CONSTANT.law_low], chain[CONSTANT.law_high])
    if chain[CONSTANT.gap_N] > 0.0:
        force = contact_step(force, chain[CONSTANT.gap_N], chain[CONSTANT.gap_softness_N])
    force += chain[STATE.thermal_N]
    return force
