"""Builds the parameter record and the initial state record of the kernels from a scenario."""

import math

import numpy as np

from firmware_sim.errors import ConfigurationError
from firmware_sim.physics.effects import Effects
from firmware_sim.physics.layout import CREEP_MODES, DELAY_SLOTS, PARAMETERS, STATE, Records
from firmware_sim.physics.preisach import virgin
from firmware_sim.physics.scenario import Scenario

CREEP_MODES_PER_DECADE = 3
NEVER_S = 1e18


def parameter_record(scenario: Scenario, generator: np.random.Generator) -> Records:
    """Return the parameters of a scenario, shape (1,); the phases of periodic effects are drawn.

    Parameters
    ----------
    scenario
        Physics of the bench.
    generator
        Source of the random draws.
    """
    parameters = np.zeros(1, PARAMETERS)
    record = parameters[0]
    record["step_s"] = scenario.step_s
    record["samples_per_step"] = scenario.step_s * scenario.sample_rate_Hz
    phases = generator.uniform(0.0, 2.0 * math.pi, 3)
    record["vibration_phase"], record["hum_phase"], record["wander_phase"] = phases
    _fill_amplifier(record, scenario)
    _fill_stack(record, scenario)
    _fill_mechanics(record, scenario)
    _fill_load_cell(record, scenario)
    _fill_acquisition(record, scenario)
    _fill_temperature(record, scenario)
    return parameters


def initial_state(parameters: Records, generator: np.random.Generator) -> Records:
    """Return the state of a virgin bench at rest, shape (1,).

    Parameters
    ----------
    parameters
        Parameter records, shape (1,).
    generator
        Source of the seed of the noise.
    """
    state = np.zeros(1, STATE)
    state[0]["random"] = generator.integers(0, 2**64, dtype=np.uint64)
    state[0]["temperature_C"] = parameters[0]["mean_degC"]
    return state


def _fill_amplifier(record: np.void, scenario: Scenario) -> None:
    amplifier, effects = scenario.amplifier, scenario.effects
    clamp_V = effects.voltage_clamp.limit_V if effects.voltage_clamp else math.inf
    slew = effects.slew_limit.limit_V_per_s if effects.slew_limit else amplifier.slew_V_per_s
    lag = effects.electrical_lag.time_constant_s if effects.electrical_lag else amplifier.time_constant_s
    record["minimum_V"], record["maximum_V"] = amplifier.minimum_V, min(amplifier.maximum_V, clamp_V)
    record["converter_step_V"], record["readback_noise_V"] = amplifier.converter_step_V, amplifier.readback_noise_V
    record["lag_s"], record["slew_V_per_s"] = lag, slew


def _fill_stack(record: np.void, scenario: Scenario) -> None:
    stack, effects = scenario.stack, scenario.effects
    record["full_V"] = stack.full_V
    record["width_scale_V"], record["bias_scale_V"] = stack.width_scale_V, stack.bias_scale_V
    share = effects.noncongruent_minor_loops.share if effects.noncongruent_minor_loops else 0.0
    irreversible_V = stack.irreversible * stack.full_V
    record["reversible"] = 1.0 - stack.irreversible
    record["width_weight"], record["bias_weight"] = 1.0, 0.0
    by_width = irreversible_V / virgin(record, stack.full_V)
    record["width_weight"], record["bias_weight"] = 0.0, 1.0
    by_bias = irreversible_V / virgin(record, stack.full_V)
    record["width_weight"], record["bias_weight"] = (1.0 - share) * by_width, share * by_bias
    _fill_creep(record, effects)
    if effects.rate_dependent_hysteresis:
        rate = effects.rate_dependent_hysteresis
        record["rate_growth"], record["rate_path_V"] = rate.growth, rate.path_V
        record["rate_reference_V_per_s"] = rate.reference_V_per_s
    if effects.gain_drift:
        record["gain_change"], record["gain_time_s"] = effects.gain_drift.relative_change, effects.gain_drift.over_s


def _fill_creep(record: np.void, effects: Effects) -> None:
    """Space the relaxations evenly in log(time); the two outermost have half the weight."""
    if effects.creep is None:
        return
    creep = effects.creep
    if creep.to_s <= creep.from_s:
        raise ConfigurationError(f"effects.creep.to_s is {creep.to_s:g}, must be above from_s = {creep.from_s:g}")
    decades = math.log10(creep.to_s / creep.from_s)
    modes = min(CREEP_MODES, 2 + math.ceil(decades * CREEP_MODES_PER_DECADE))
    weight = np.full(modes, creep.per_decade * decades / (modes - 1))
    weight[[0, -1]] *= 0.5
    record["creep_modes"] = modes
    record["creep_tau_s"][:modes] = np.geomspace(creep.from_s, creep.to_s, modes)
    record["creep_weight"][:modes] = weight


def _fill_mechanics(record: np.void, scenario: Scenario) -> None:
    mechanics, effects = scenario.mechanics, scenario.effects
    record["full_N"] = mechanics.full_N
    record["stiffening"], record["softening"] = mechanics.stiffening, mechanics.softening
    record["curvature"] = effects.output_nonlinearity.curvature if effects.output_nonlinearity else 0.0
    if effects.contact_gap:
        record["gap_N"], record["touch_N"] = effects.contact_gap.gap_N, effects.contact_gap.touch_N
    if effects.friction:
        record["friction_N"], record["presliding_N"] = effects.friction.force_N, effects.friction.presliding_N
    if effects.resonance:
        record["mode_rad_per_s"] = 2.0 * math.pi * effects.resonance.frequency_Hz
        record["mode_damping"] = effects.resonance.damping_ratio
    record["drift_N_per_K"] = effects.thermal_drift.coefficient_N_per_K if effects.thermal_drift else 0.0
    if effects.load_step:
        step = effects.load_step
        record["load_N"], record["load_on_s"], record["load_rise_s"] = step.step_N, step.on_s, step.rise_s
        record["load_off_s"] = step.off_s if step.off_s is not None else NEVER_S
    if effects.vibration:
        record["vibration_N"] = effects.vibration.amplitude_N
        record["vibration_rad_per_s"] = 2.0 * math.pi * effects.vibration.frequency_Hz
        record["vibration_breathing"] = effects.vibration.breathing


def _fill_load_cell(record: np.void, scenario: Scenario) -> None:
    cell, effects = scenario.load_cell, scenario.effects
    record["white_N"], record["coloured_N"] = cell.white_noise_N, cell.coloured_noise_N
    record["coloured_forgetting"] = math.exp(-2.0 * math.pi * cell.coloured_corner_Hz / scenario.sample_rate_Hz)
    record["leakage_s"] = effects.charge_leakage.time_constant_s if effects.charge_leakage else 0.0
    if effects.sensor_filter:
        record["filter_rad_per_s"] = 2.0 * math.pi * effects.sensor_filter.cutoff_Hz
        record["filter_order"] = effects.sensor_filter.order
    if effects.feedthrough:
        record["feedthrough_N_s_per_V"] = effects.feedthrough.coefficient_N_s_per_V
        record["feedthrough_lag_s"] = 0.5 / math.pi / effects.feedthrough.bandwidth_Hz
    if effects.mains_hum:
        record["hum_N"] = effects.mains_hum.amplitude_N
        record["hum_rad_per_s"] = 2.0 * math.pi * effects.mains_hum.frequency_Hz


def _fill_acquisition(record: np.void, scenario: Scenario) -> None:
    cell, effects = scenario.load_cell, scenario.effects
    record["reading_low_N"], record["reading_high_N"] = cell.low_N, cell.high_N
    record["converter_step_N"] = effects.quantisation.step_N if effects.quantisation else cell.converter_step_N
    if effects.transport_delay:
        record["delay_steps"] = effects.transport_delay.delay_s / scenario.step_s
        if record["delay_steps"] >= DELAY_SLOTS - 1:
            most_s = (DELAY_SLOTS - 2) * scenario.step_s
            raise ConfigurationError(
                f"effects.transport_delay.delay_s is {effects.transport_delay.delay_s:g}, must be at most {most_s:g}"
            )
    if effects.sensor_dropout:
        for index, (from_s, to_s) in enumerate(effects.sensor_dropout.places_s):
            record["dropout_from_s"][index], record["dropout_to_s"][index] = from_s, to_s
        record["dropouts"] = len(effects.sensor_dropout.places_s)


def _fill_temperature(record: np.void, scenario: Scenario) -> None:
    temperature = scenario.temperature
    record["mean_degC"], record["trip_degC"] = temperature.mean_degC, temperature.trip_degC
    record["wander_K"], record["temperature_noise_K"] = temperature.wander_K, temperature.noise_K
    record["wander_rad_per_s"] = 2.0 * math.pi / temperature.period_s
