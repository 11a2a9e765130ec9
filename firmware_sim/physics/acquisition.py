"""From the signal of the load cell to readings: transport delay, sampling, noise, mains hum, converter, frozen spans.

The device samples on its own clock. A sample between two physics steps is interpolated linearly. The random generator
lives in the state record, so that a run is reproducible to the bit from its seed.

Source: splitmix64 of Steele, Lea, Flood (2014), Fast splittable pseudorandom number generators; Box, Muller (1958), A
note on the generation of random normal deviates.
"""

import math

from numba import njit, uint64

from firmware_sim.physics.layout import (
    DELAY_SLOTS,
    OUTPUT_OFF_FAULTS,
    STATUS_CLAMPED,
    STATUS_OUTPUT_ON,
    STATUS_OVER_TEMPERATURE,
    STATUS_WATCHDOG_TRIPPED,
    Record,
)


@njit(cache=True)
def acquire(state: Record, parameters: Record) -> None:
    """Delay the signal of the load cell by one physics step, and sample it when a sample is due.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    """
    _delay_signal(state, parameters)
    state.sample_phase += parameters.samples_per_step
    while state.sample_phase >= 1.0 - 1e-9:
        state.sample_phase -= 1.0
        late = max(state.sample_phase, 0.0) / parameters.samples_per_step
        sample(state, parameters, late)


@njit(cache=True)
def _delay_signal(state: Record, parameters: Record) -> None:
    """Delay the signal of the load cell [N] by `delay_steps`, which need not be a whole number."""
    state.previous_arrived_N = state.arrived_N
    if parameters.delay_steps <= 0.0:
        state.arrived_N = state.cell_N
        return
    state.delay[state.steps % DELAY_SLOTS] = state.cell_N
    whole = int(parameters.delay_steps)
    part = parameters.delay_steps - whole
    newer_N = state.delay[(state.steps - whole) % DELAY_SLOTS]
    older_N = state.delay[(state.steps - whole - 1) % DELAY_SLOTS]
    state.arrived_N = newer_N + part * (older_N - newer_N)


@njit(cache=True)
def sample(state: Record, parameters: Record, late: float) -> None:
    """Take one device sample at `late` physics steps before the present, 0 to 1.

    Parameters
    ----------
    state, parameters
        State record, which changes, and parameter record of a bench.
    late
        Time from the sample to the present [physics steps], 0 to 1.
    """
    state.samples += 1
    time_s = (state.steps - late) * parameters.step_s
    force_N = state.arrived_N - late * (state.arrived_N - state.previous_arrived_N)
    force_N += _noise(state, parameters)
    if parameters.hum_N != 0.0:
        force_N += _hum(parameters, time_s)
    if parameters.converter_step_N > 0.0:
        force_N = parameters.converter_step_N * math.floor(force_N / parameters.converter_step_N + 0.5)
    if not _frozen(parameters, time_s):
        state.reading_N = min(max(force_N, parameters.reading_low_N), parameters.reading_high_N)
    state.readback_V = state.output_V + parameters.readback_noise_V * _normal(state)
    _update_temperature(state, parameters, time_s)
    state.status = _status(state, parameters)


@njit(cache=True)
def _update_temperature(state: Record, parameters: Record, time_s: float) -> None:
    """Set the temperature [degC]: mean plus two slow sines with an irrational ratio of periods, 0 at power-on."""
    phase = parameters.wander_rad_per_s * time_s + parameters.wander_phase
    rest = 0.75 * math.sin(parameters.wander_phase) + 0.25 * math.sin(1.7 * parameters.wander_phase)
    wave = 0.75 * math.sin(phase) + 0.25 * math.sin(2.618 * phase - 0.918 * parameters.wander_phase)
    state.temperature_C = parameters.mean_degC + parameters.wander_K * (wave - rest)
    state.temperature_reading_C = state.temperature_C + parameters.temperature_noise_K * _normal(state)


@njit(cache=True)
def _status(state: Record, parameters: Record) -> int:
    """Return the status bits."""
    bits: int = state.fault_bits
    if (state.fault_bits & OUTPUT_OFF_FAULTS) == 0:
        bits |= STATUS_OUTPUT_ON
    if state.tripped != 0:
        bits |= STATUS_WATCHDOG_TRIPPED
    if state.clamped != 0:
        bits |= STATUS_CLAMPED
    if state.temperature_C > parameters.trip_degC:
        bits |= STATUS_OVER_TEMPERATURE
    return bits


@njit(cache=True)
def _hum(parameters: Record, time_s: float) -> float:
    """Return the mains hum [N]: fundamental, third and fifth harmonic with a slowly varying phase."""
    phase = parameters.hum_rad_per_s * time_s + parameters.hum_phase + 0.05 * math.sin(0.11 * time_s)
    wave = math.sin(phase) + 0.3 * math.sin(3.0 * phase + 0.4) + 0.1 * math.sin(5.0 * phase + 1.1)
    hum_N: float = parameters.hum_N * wave
    return hum_N


@njit(cache=True)
def _frozen(parameters: Record, time_s: float) -> bool:
    """Return whether the reading is frozen."""
    for span in range(parameters.dropouts):
        if parameters.dropout_from_s[span] <= time_s < parameters.dropout_to_s[span]:
            return True
    return False


@njit(cache=True)
def _noise(state: Record, parameters: Record) -> float:
    """Return one sample of noise [N]: white noise plus noise with a first-order low-pass spectrum."""
    noise_N: float = parameters.white_N * _normal(state)
    if parameters.coloured_N > 0.0:
        keep = parameters.coloured_forgetting
        fresh_N = parameters.coloured_N * math.sqrt(1.0 - keep * keep) * _normal(state)
        state.coloured_N = keep * state.coloured_N + fresh_N
        noise_N += state.coloured_N
    return noise_N


@njit(cache=True)
def _normal(state: Record) -> float:
    """Return a standard normal number (Box-Muller); every second one is stored by the call before."""
    if state.has_spare != 0:
        state.has_spare = 0
        spare: float = state.spare_normal
        return spare
    radius = math.sqrt(-2.0 * math.log(_uniform(state)))
    angle = 2.0 * math.pi * _uniform(state)
    state.spare_normal = radius * math.sin(angle)
    state.has_spare = 1
    return radius * math.cos(angle)


@njit(cache=True)
def _uniform(state: Record) -> float:
    """Return a uniform number in (0, 1] (splitmix64)."""
    state.random = uint64(state.random + uint64(0x9E3779B97F4A7C15))
    mixed = uint64(state.random)
    mixed = (mixed ^ (mixed >> uint64(30))) * uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> uint64(27))) * uint64(0x94D049BB133111EB)
    mixed ^= mixed >> uint64(31)
    uniform: float = (float(mixed >> uint64(11)) + 1.0) * 2.0**-53
    return uniform
