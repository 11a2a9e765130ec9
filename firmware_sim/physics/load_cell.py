"""The analogue side of the load cell: leaking charge amplifier, cross-talk from the drive, low-pass.

- Leakage: `dy/dt = dF/dt - y / tau`.
- Cross-talk: `k du/dt`, behind a first-order low-pass.
- Low-pass: first order, or second order Butterworth.

All are integrated by the trapezoidal rule at the physics step.
"""

import math

from numba import njit

from firmware_sim.physics.layout import Record


@njit(cache=True)
def sense(state: Record, parameters: Record) -> None:
    """Advance the analogue signal of the load cell [N] by one physics step.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    """
    signal_N = state.true_force_N
    if parameters.leakage_s > 0.0:
        half = 0.5 * parameters.step_s / parameters.leakage_s
        rise_N = state.true_force_N - state.previous_true_N
        state.leaked_N = (state.leaked_N * (1.0 - half) + rise_N) / (1.0 + half)
        signal_N = state.leaked_N
    state.previous_true_N = state.true_force_N
    if parameters.feedthrough_N_s_per_V != 0.0:
        signal_N += _cross_talk(state, parameters)
    state.cell_N = _low_pass(state, parameters, signal_N) if parameters.filter_rad_per_s > 0.0 else signal_N


@njit(cache=True)
def _cross_talk(state: Record, parameters: Record) -> float:
    """Return the cross-talk `k du/dt` [N], limited to the bandwidth of the input stage."""
    rate_V_per_s = (state.output_V - state.feedthrough_V) / (parameters.feedthrough_lag_s + 0.5 * parameters.step_s)
    state.feedthrough_V += rate_V_per_s * parameters.step_s
    coupled_N: float = parameters.feedthrough_N_s_per_V * rate_V_per_s
    return coupled_N


@njit(cache=True)
def _low_pass(state: Record, parameters: Record, signal_N: float) -> float:
    """Return the filtered signal [N]."""
    half = 0.5 * parameters.step_s * parameters.filter_rad_per_s
    middle_N = 0.5 * (state.filter_in_N + signal_N)
    state.filter_in_N = signal_N
    if parameters.filter_order < 2.0:
        state.filter_N += 2.0 * half * (middle_N - state.filter_N) / (1.0 + half)
    else:
        # x' = w r, r' = w (u - x) - sqrt(2) w r; solved for the rate r in the middle of the step.
        rate = (state.filter_N_per_s + half * (middle_N - state.filter_N)) / (1.0 + math.sqrt(2.0) * half + half * half)
        state.filter_N += 2.0 * half * rate
        state.filter_N_per_s = 2.0 * rate - state.filter_N_per_s
    filtered_N: float = state.filter_N
    return filtered_N
