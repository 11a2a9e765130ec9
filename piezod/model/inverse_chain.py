"""The inverse of the whole chain, effects included: one compiled step plans a voltage, one commits what was applied.

    plan      force -> less thermal drift -> gap -> curved law -> force law -> gain -> creep's states -> plays at this
              rate -> lag -> output stage
    commit    output stage -> current limit -> lag -> rate -> plays -> creep, with the voltage that was really written

A tick holds its command, so every step is that of a held input and what is planned is reached at the end of the tick:
the next reading shows it. Everything sits in one array of constants and states beside the operator's packed one.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.effects.kernels import first_order_coefficients, first_order_step, time_constant_at
from piezod.effects.output_nonlinearity import law_step
from piezod.effects.rate_dependent_hysteresis import OFFSET, POWER, rate_step
from piezod.effects.slew_limit import slew_step
from piezod.effects.voltage_clamp import clamp_step
from piezod.operators.dead_zone import dead_zone_step
from piezod.operators.play import play_solve, play_step, play_value, play_wider_solve, play_wider_step
from piezod.operators.prandtl_ishlinskii import HEADER

Array = NDArray[np.float64]

# Constants, then states, then the elements of the creep: keep, ramp, weight and state of each.
LIMIT_V, KNEE_V, SLEW_V, LAG_S, LAG_SWELL = 0, 1, 2, 3, 4
GROWTH, REFERENCE_V_PER_S, RATE_WAY_V, KIND, OFFSET_V, DT_S = 5, 6, 7, 8, 9, 10
GAIN, SQUARE, CUBE, LOW, HIGH, SPAN_N, GAP_N, SOFT_N = 11, 12, 13, 14, 15, 16, 17, 18
CREEP_BY_VOLTAGE = 19
SLEWED_V, APPLIED_V, RATE_V_PER_S, RESTED_S, START_V, START_STROKE_V, DRIVE_V, THERMAL_N = (
    20,
    21,
    22,
    23,
    24,
    25,
    26,
    27,
)
FIRST = 28

MOST_PASSES, SAME_V = 40, 1e-9  # the rate of a tick depends on the voltage that is looked for
BISECTIONS = 60


@numba.njit(cache=True)
def _widening(chain: Array, applied_V: float) -> tuple[float, float, float, float]:
    """Factor and offset of the thresholds at the end of a tick that ends at a voltage, with the rate behind them."""
    moved_V = abs(applied_V - chain[APPLIED_V])
    rate, rested_s = rate_step(chain[RATE_V_PER_S], chain[RESTED_S], moved_V, chain[DT_S], chain[RATE_WAY_V])
    wider = chain[GROWTH] * math.log1p(rate / chain[REFERENCE_V_PER_S])
    if chain[KIND] == OFFSET:
        return 1.0, chain[OFFSET_V] * wider, rate, rested_s
    return (math.exp(wider) if chain[KIND] == POWER else 1.0 + wider), 0.0, rate, rested_s


@numba.njit(cache=True)
def _through_gap(force: float, gap: float, soft: float) -> float:
    """Force in front of the gap at which `force` arrives behind it; for none or less, where touching begins."""
    soft = min(soft, gap)
    if force <= 0.0:
        return gap - soft
    if force < soft:
        return gap + 2.0 * math.sqrt(force * soft) - soft
    return gap + force


@numba.njit(cache=True)
def _through_law(chain: Array, force: float) -> float:
    """Force at which the curved law gives `force`: a rising function, closed in on."""
    aim, span = force / chain[SPAN_N], chain[SPAN_N]
    low, high = aim - 1.0, aim + 1.0
    while law_step(low, chain[SQUARE], chain[CUBE], chain[LOW], chain[HIGH]) > aim:
        low -= 2.0 * (high - low)
    while law_step(high, chain[SQUARE], chain[CUBE], chain[LOW], chain[HIGH]) < aim:
        high += 2.0 * (high - low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if law_step(middle, chain[SQUARE], chain[CUBE], chain[LOW], chain[HIGH]) < aim:
            low = middle
        else:
            high = middle
    result: float = 0.5 * (low + high) * span
    return result


@numba.njit(cache=True)
def _creep(chain: Array) -> tuple[float, float]:
    """What creep adds at the end of a tick: a constant, and how much a volt of its drive (from the start) adds."""
    constant, by_drive, before_V = 0.0, 0.0, chain[DRIVE_V]
    count = (chain.size - FIRST) // 4
    for j in range(FIRST, FIRST + count):
        keep, ramp, weight, state = chain[j], chain[j + count], chain[j + 2 * count], chain[j + 3 * count]
        constant += weight * first_order_step(state, before_V, 0.0, keep, ramp)
        by_drive += weight * ramp
    return constant, by_drive


@numba.njit(cache=True)
def plan_chain_step(packed: Array, chain: Array, force: float) -> float:
    """Voltage [V] at which the force at the end of the tick would be `force`; moves no state."""
    plays, zones = int(packed[0]), int(packed[1])
    force -= chain[THERMAL_N]
    if chain[GAP_N] > 0.0:
        force = _through_gap(force, chain[GAP_N], chain[SOFT_N])
    if chain[SPAN_N] > 0.0:
        force = _through_law(chain, force)
    stroke_V = dead_zone_step(packed, HEADER + 3 * plays, zones, force - packed[2]) / chain[GAIN]
    constant, by_drive = _creep(chain)
    ratio = chain[CREEP_BY_VOLTAGE]
    if ratio > 0.0:  # driven by the voltage: that of the tick before serves first
        drive_V = ratio * (chain[APPLIED_V] - chain[START_V])
        v = stroke_V - constant - by_drive * drive_V
    else:
        v = (stroke_V - constant + by_drive * chain[START_STROKE_V]) / (1.0 + by_drive)
    applied_V = _through_plays(packed, chain, plays, v)
    if ratio > 0.0 and by_drive > 0.0:
        drive_V = ratio * (applied_V - chain[START_V])
        applied_V = _through_plays(packed, chain, plays, stroke_V - constant - by_drive * drive_V)
    if chain[LAG_S] > 0.0:
        keep, _ = _lag(chain, 1.0)
        applied_V = chain[APPLIED_V] + (applied_V - chain[APPLIED_V]) / (1.0 - keep)
    return _through_clamp(applied_V, chain[LIMIT_V], chain[KNEE_V])


@numba.njit(cache=True)
def _lag(chain: Array, hold: float) -> tuple[float, float]:
    """`keep` and `ramp` of the lag at the voltage that the stack stands at."""
    tau_s = time_constant_at(chain[APPLIED_V], chain[LAG_S], chain[LAG_SWELL])
    keep, ramp = first_order_coefficients(tau_s, chain[DT_S], hold)
    return keep, ramp


@numba.njit(cache=True)
def _through_plays(packed: Array, chain: Array, plays: int, v: float) -> float:
    if chain[GROWTH] == 0.0:
        return play_solve(packed, HEADER, plays, v)
    applied_V: float = chain[APPLIED_V]
    for _ in range(MOST_PASSES):
        factor, more, _, _ = _widening(chain, applied_V)
        before_V, applied_V = applied_V, play_wider_solve(packed, HEADER, plays, v, factor, more)
        if abs(applied_V - before_V) < SAME_V:
            return before_V  # the one that the thresholds belong to: a voltage that rests has another rate
    return applied_V


@numba.njit(cache=True)
def _through_clamp(voltage_V: float, limit_V: float, knee_V: float) -> float:
    """Command at which the output stage gives a voltage; where it cannot, the one from which on it gives all it can."""
    inside = voltage_V - (limit_V - knee_V)
    if inside <= 0.0:
        return voltage_V
    if inside >= knee_V:
        return limit_V + knee_V
    return limit_V + knee_V - 2.0 * math.sqrt(knee_V * (knee_V - inside))


@numba.njit(cache=True)
def commit_chain_step(packed: Array, chain: Array, voltage_V: float) -> None:
    """Move every state through a tick in which `voltage_V` was written."""
    plays = int(packed[0])
    given_V = clamp_step(voltage_V, chain[LIMIT_V], chain[KNEE_V])
    before_V, applied_V = chain[SLEWED_V], chain[APPLIED_V]
    slewed_V = slew_step(before_V, given_V, given_V, chain[SLEW_V]) if given_V != before_V else given_V
    chain[SLEWED_V] = slewed_V
    if chain[LAG_S] > 0.0:
        keep, ramp = _lag(chain, 0.0 if slewed_V != given_V else 1.0)  # what the current limits runs straight
        applied_V = first_order_step(applied_V, before_V, slewed_V, keep, ramp)
    else:
        applied_V = slewed_V
    if chain[GROWTH] > 0.0:
        factor, more, rate, rested_s = _widening(chain, applied_V)
        chain[RATE_V_PER_S], chain[RESTED_S] = rate, rested_s
        v = play_wider_step(packed, HEADER, plays, applied_V, factor, more)
    else:
        v = play_step(packed, HEADER, plays, applied_V)
    chain[APPLIED_V] = applied_V
    ratio = chain[CREEP_BY_VOLTAGE]
    drive_V = ratio * (applied_V - chain[START_V]) if ratio > 0.0 else v - chain[START_STROKE_V]
    before_V, chain[DRIVE_V] = chain[DRIVE_V], drive_V
    count = (chain.size - FIRST) // 4
    for j in range(FIRST, FIRST + count):
        state = j + 3 * count
        chain[state] = first_order_step(chain[state], before_V, drive_V, chain[j], chain[j + count])


@numba.njit(cache=True)
def start_chain(packed: Array, chain: Array) -> None:
    """Rest where the plays stand: nothing crept, nothing moving."""
    plays = int(packed[0])
    voltage_V = packed[HEADER + 2 * plays]  # the play without a threshold stands at its input
    chain[SLEWED_V] = chain[APPLIED_V] = chain[START_V] = voltage_V
    chain[START_STROKE_V] = play_value(packed, HEADER, plays)
    chain[RATE_V_PER_S] = chain[RESTED_S] = chain[DRIVE_V] = chain[THERMAL_N] = 0.0
    count = (chain.size - FIRST) // 4
    chain[FIRST + 3 * count :] = 0.0
