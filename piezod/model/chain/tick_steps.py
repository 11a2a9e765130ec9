"""The compiled walks over the chain of a model, tick by tick.

    plan      force -> effects of the force -> force law -> effects of the stack -> plays -> amplifier -> voltage
    commit    voltage -> amplifier -> plays -> effects of the stack -> force law -> effects of the force
    read      force -> effects behind the force -> reading

A tick holds its command. The planned force is reached at the end of the tick, and the next reading shows it. `state`
and `program` are the arrays of `tick_chain.TickChain`: all numbers of the chain, and the addresses of its steps.
"""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.effects.tick import SHARED
from piezod.model.chain.compiled_steps import call_step
from piezod.operators.dead_zone import dead_zone_step
from piezod.operators.play import play_solve, play_step, play_value, play_wider_solve, play_wider_step
from piezod.operators.prandtl_ishlinskii import HEADER

Program = NDArray[np.int64]

AMPLIFIER, HYSTERESIS, STACK, FORCE, READING, FOLLOWED, MEASURED = range(7)
"""Stages of a chain. MEASURED holds the effects that take a further channel."""
SHARED_AT, ZONES_AT, ZONES, LAST_OF_FORCE = range(4)  # row 0: shared memory, dead zones, last row of the true force
FIRST, END = range(2)  # row 1 + stage: rows of its effects
ADVANCE, INVERT, SETTLE, OWN_AT = range(4)  # a row of an effect: addresses of its steps, and the place of its memory
FIRST_EFFECT = 1 + len((AMPLIFIER, HYSTERESIS, STACK, FORCE, READING, FOLLOWED, MEASURED))

MOST_PASSES, SAME_V = 40, 1e-9  # of the iteration for the voltage, whose rate widens the plays
FROZEN = 3.0  # [samples]; so many equal readings are a frozen reading
BYTES = 8


@numba.njit(cache=True)
def _forward(program: Program, state: Array, stage: int, step: int, signal: float) -> float:
    """Output of a stage: its steps ADVANCE or SETTLE, one after the other."""
    base, shared = state.ctypes.data, state.ctypes.data + BYTES * program[0, SHARED_AT]
    for k in range(program[1 + stage, FIRST], program[1 + stage, END]):
        if program[k, step] != 0:
            signal = call_step(program[k, step], base + BYTES * program[k, OWN_AT], shared, signal)
    return signal


@numba.njit(cache=True)
def _backward(program: Program, state: Array, stage: int, signal: float) -> float:
    """Input of a stage for an output: its steps INVERT, the last one first."""
    base, shared = state.ctypes.data, state.ctypes.data + BYTES * program[0, SHARED_AT]
    for k in range(program[1 + stage, END] - 1, program[1 + stage, FIRST] - 1, -1):
        if program[k, INVERT] != 0:
            signal = call_step(program[k, INVERT], base + BYTES * program[k, OWN_AT], shared, signal)
    return signal


@numba.njit(cache=True)
def _widen(program: Program, state: Array, step: int, applied_V: float) -> tuple[float, float]:
    """Factor and offset [V] of the thresholds for a tick that ends at `applied_V`."""
    at = program[0, SHARED_AT]
    state[at + SHARED.factor], state[at + SHARED.offset_V] = 1.0, 0.0
    _forward(program, state, HYSTERESIS, step, applied_V)
    return state[at + SHARED.factor], state[at + SHARED.offset_V]


@numba.njit(cache=True)
def _invert_plays(program: Program, state: Array, stroke_V: float) -> float:
    """Voltage at which the plays give `stroke_V` [V]; iterated where the rate of the tick widens them."""
    plays = int(state[0])
    if program[1 + HYSTERESIS, FIRST] == program[1 + HYSTERESIS, END]:
        return play_solve(state, HEADER, plays, stroke_V)
    applied_V: float = state[program[0, SHARED_AT] + SHARED.committed_V]
    for _ in range(MOST_PASSES):
        factor, offset_V = _widen(program, state, INVERT, applied_V)
        before_V, applied_V = applied_V, play_wider_solve(state, HEADER, plays, stroke_V, factor, offset_V)
        if abs(applied_V - before_V) < SAME_V:
            return before_V  # the voltage that belongs to these thresholds: a resting voltage has another rate
    return applied_V


@numba.njit(cache=True)
def plan_chain(program: Program, state: Array, force_N: float) -> float:
    """Voltage [V] that gives the force `force_N` [N] at the end of the tick; changes no state.

    Parameters
    ----------
    program, state
        Arrays of `TickChain`.
    force_N
        Force to reach [N].
    """
    at, plays, zones = program[0, SHARED_AT], int(state[0]), int(state[1])
    state[at + SHARED.before_V] = state[at + SHARED.now_V] = state[at + SHARED.committed_V]
    force_N = _backward(program, state, FORCE, force_N)
    stroke_V = dead_zone_step(state, HEADER + 3 * plays, zones, force_N - state[2])
    state[at + SHARED.used_now_V] = 0.0
    applied_V = _invert_plays(program, state, _backward(program, state, STACK, stroke_V))
    if state[at + SHARED.used_now_V] > 0.0:
        state[at + SHARED.now_V] = applied_V
        applied_V = _invert_plays(program, state, _backward(program, state, STACK, stroke_V))
    return _backward(program, state, AMPLIFIER, applied_V)


@numba.njit(cache=True)
def commit_chain(program: Program, state: Array, voltage_V: float) -> None:
    """Advance every state by a tick in which `voltage_V` [V] was written.

    Parameters
    ----------
    program, state
        Arrays of `TickChain`; the states change.
    voltage_V
        Voltage that was written [V].
    """
    at, plays = program[0, SHARED_AT], int(state[0])
    state[at + SHARED.before_V], state[at + SHARED.runs_straight] = state[at + SHARED.committed_V], 0.0
    applied_V = _forward(program, state, AMPLIFIER, ADVANCE, voltage_V)
    state[at + SHARED.now_V] = state[at + SHARED.committed_V] = applied_V
    if program[1 + HYSTERESIS, FIRST] == program[1 + HYSTERESIS, END]:
        stroke_V = play_step(state, HEADER, plays, applied_V)
    else:
        factor, offset_V = _widen(program, state, ADVANCE, applied_V)
        stroke_V = play_wider_step(state, HEADER, plays, applied_V, factor, offset_V)
    stroke_V = _forward(program, state, STACK, ADVANCE, stroke_V)
    state[at + SHARED.force_N] = _force(program, state, ADVANCE, stroke_V)


@numba.njit(cache=True)
def _force(program: Program, state: Array, step: int, stroke_V: float) -> float:
    """Force of a stroke, as far as the plan inverts it [N]."""
    force_N = dead_zone_step(state, program[0, ZONES_AT], program[0, ZONES], stroke_V) + state[2]
    return _forward(program, state, FORCE, step, force_N)


@numba.njit(cache=True)
def settle_chain(program: Program, state: Array) -> None:
    """Set every effect to rest at the present states of the plays.

    Parameters
    ----------
    program, state
        Arrays of `TickChain`; the states change.
    """
    at, plays = program[0, SHARED_AT], int(state[0])
    voltage_V = state[HEADER + 2 * plays]  # the play with threshold 0 equals its input
    state[at + SHARED.before_V] = state[at + SHARED.now_V] = state[at + SHARED.committed_V] = voltage_V
    state[at + SHARED.start_V] = voltage_V
    _forward(program, state, AMPLIFIER, SETTLE, voltage_V)
    _forward(program, state, HYSTERESIS, SETTLE, voltage_V)
    stroke_V = _forward(program, state, STACK, SETTLE, play_value(state, HEADER, plays))
    force_N = _force(program, state, SETTLE, stroke_V)
    state[at + SHARED.force_N] = force_N
    _forward(program, state, READING, SETTLE, force_N)
    state[at + SHARED.last_reading_N] = math.nan
    state[at + SHARED.equal_readings] = state[at + SHARED.difference_N] = 0.0


@numba.njit(cache=True)
def measure_chain(program: Program, state: Array, value: float) -> None:
    """Give a reading of a further channel to the effects that need it.

    Parameters
    ----------
    program, state
        Arrays of `TickChain`; the states change.
    value
        Reading, in the unit of the channel; nan without one.
    """
    base, shared = state.ctypes.data, state.ctypes.data + BYTES * program[0, SHARED_AT]
    for k in range(program[1 + MEASURED, FIRST], program[1 + MEASURED, END]):
        call_step(program[k, ADVANCE], base + BYTES * program[k, OWN_AT], shared, value)


@numba.njit(cache=True)
def read_chain(
    program: Program, state: Array, voltage_V: Array, reading_N: Array, expected_N: Array, corrected_N: Array
) -> None:
    """Commit one tick per voltage; expected readings and corrected forces at the end of each.

    Parameters
    ----------
    program, state
        Arrays of `TickChain`; the states change.
    voltage_V, reading_N
        Written voltages [V] and readings [N], shape (N,).
    expected_N, corrected_N
        Results, shape (N,) [N].
    """
    at = program[0, SHARED_AT]
    base, shared = state.ctypes.data, state.ctypes.data + BYTES * at
    for k in range(voltage_V.size):
        commit_chain(program, state, voltage_V[k])
        force_N = expected = state[at + SHARED.force_N]
        for row in range(program[1 + READING, FIRST], program[1 + READING, END]):
            expected = call_step(program[row, ADVANCE], base + BYTES * program[row, OWN_AT], shared, expected)
            if row == program[0, LAST_OF_FORCE]:
                force_N = expected
        difference_N = reading_N[k] - expected
        for row in range(program[1 + FOLLOWED, FIRST], program[1 + FOLLOWED, END]):
            part_N = call_step(program[row, ADVANCE], base + BYTES * program[row, OWN_AT], shared, difference_N)
            expected += part_N
            difference_N -= part_N
        equal = reading_N[k] == state[at + SHARED.last_reading_N]
        state[at + SHARED.equal_readings] = state[at + SHARED.equal_readings] + 1.0 if equal else 0.0
        state[at + SHARED.last_reading_N] = reading_N[k]
        if state[at + SHARED.equal_readings] + 1.0 < FROZEN and abs(difference_N) < math.inf:
            state[at + SHARED.difference_N] = difference_N
        expected_N[k] = expected
        corrected_N[k] = force_N + state[at + SHARED.difference_N]
