"""The physics, step by step: one compiled loop through the whole chain."""

import numpy as np
from numba import njit

from firmware_sim.physics.acquisition import acquire, sample
from firmware_sim.physics.amplifier import drive, watch_for_commands
from firmware_sim.physics.layout import Record, Records
from firmware_sim.physics.load_cell import sense
from firmware_sim.physics.mechanics import load
from firmware_sim.physics.stack import deform


@njit(cache=True)
def begin(states: Records, parameter_sets: Records) -> None:
    """Take the reading that stands at power-on; the heartbeat counts from there."""
    sample(states[0], parameter_sets[0], 0.0)
    states[0].samples = 0


@njit(cache=True)
def advance(states: Records, parameter_sets: Records, steps: int) -> None:
    """Advance a bench, records of shape (1,), by a number of physics steps."""
    state = states[0]
    parameters = parameter_sets[0]
    for _ in range(steps):
        _step(state, parameters)


@njit(cache=True)
def _step(state: Record, parameters: Record) -> None:
    """Let one physics step pass through amplifier, stack, mechanics, load cell and converter."""
    state.steps += 1
    watch_for_commands(state, parameters)
    drive(state, parameters)
    deform(state, parameters)
    load(state, parameters)
    sense(state, parameters)
    acquire(state, parameters)


@njit(cache=True)
def run(
    states: Records,
    parameter_sets: Records,
    voltage_V: np.ndarray,
    ticks: np.ndarray,
    ends: np.ndarray,
    force_N: np.ndarray,
    interpolate: bool,
) -> None:
    """Drive a bench with a voltage record [V] and note a force reading [N] each sample.

    Command k acts from physics step `ticks[k]` on; reading k is taken at step `ends[k]`. The two clocks are given
    apart, so that they can run at different rates. With `interpolate` the command runs straight from one value to the
    next.
    """
    state = states[0]
    parameters = parameter_sets[0]
    command, last, step = 0, voltage_V.size - 1, 0
    for reading in range(ends.size):
        while step < ends[reading]:
            while command < last and ticks[command + 1] <= step:
                command += 1
            state.command_V = voltage_V[command]
            if interpolate and command < last:
                part = (step - ticks[command]) / (ticks[command + 1] - ticks[command])
                state.command_V += part * (voltage_V[command + 1] - voltage_V[command])
            state.quiet_steps = 0
            _step(state, parameters)
            step += 1
        force_N[reading] = state.reading_N
