"""The compiled loops: one physics step runs through the whole chain, from command to sample."""

import numpy as np
from numba import njit

from firmware_sim.physics.acquisition import acquire, sample
from firmware_sim.physics.amplifier import drive, run_watchdog
from firmware_sim.physics.layout import Record, Records
from firmware_sim.physics.load_cell import sense
from firmware_sim.physics.mechanics import load
from firmware_sim.physics.stack import deform


@njit(cache=True)
def take_first_sample(states: Records, parameter_sets: Records) -> None:
    """Take the sample at power-on; the heartbeat counts from it.

    Parameters
    ----------
    states, parameter_sets
        State and parameter records, shape (1,); the state changes.
    """
    sample(states[0], parameter_sets[0], 0.0)
    states[0].samples = 0


@njit(cache=True)
def advance(states: Records, parameter_sets: Records, steps: int) -> None:
    """Advance a bench (records of shape (1,)) by a number of physics steps.

    Parameters
    ----------
    states, parameter_sets
        State and parameter records, shape (1,); the state changes.
    steps
        Number of physics steps, at least 0.
    """
    state = states[0]
    parameters = parameter_sets[0]
    for _ in range(steps):
        _step(state, parameters)


@njit(cache=True)
def _step(state: Record, parameters: Record) -> None:
    """Advance by one physics step: watchdog, amplifier, stack, mechanics, load cell, acquisition."""
    state.steps += 1
    run_watchdog(state, parameters)
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
    """Drive a bench with a voltage record [V] and store one force reading [N] per sample.

    Command k acts from physics step `ticks[k]` on. Reading k is taken at step `ends[k]`. The two can run at different
    rates, for a skewed clock. With `interpolate` the command runs straight from one value to the next.

    Parameters
    ----------
    states, parameter_sets
        State and parameter records, shape (1,); the state changes.
    voltage_V
        Commands, shape (M,) [V].
    ticks
        First physics step of each command, ascending, shape (M,).
    ends
        Physics step of each reading, ascending, shape (N,).
    force_N
        Buffer for the readings, shape (N,) [N].
    interpolate
        Whether the command runs straight.
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
            state.steps_since_command = 0
            _step(state, parameters)
            step += 1
        force_N[reading] = state.reading_N
