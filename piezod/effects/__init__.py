"""The catalogue of physical effects: one file for each, and the registry `EFFECTS` in the order of the signal chain."""

from piezod.effects import (
    charge_leakage,
    clock_skew,
    contact_gap,
    creep,
    electrical_lag,
    feedthrough,
    friction,
    gain_drift,
    load_step,
    mains_hum,
    noncongruent_minor_loops,
    output_nonlinearity,
    quantisation,
    rate_dependent_hysteresis,
    resonance,
    sensor_dropout,
    sensor_filter,
    slew_limit,
    thermal_drift,
    transport_delay,
    vibration,
    voltage_clamp,
)
from piezod.effects.effect import Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search

EFFECTS: dict[str, Effect] = {
    module.EFFECT.name: module.EFFECT
    for module in (
        voltage_clamp,
        slew_limit,
        electrical_lag,
        rate_dependent_hysteresis,
        noncongruent_minor_loops,
        creep,
        gain_drift,
        output_nonlinearity,
        contact_gap,
        friction,
        thermal_drift,
        load_step,
        resonance,
        vibration,
        charge_leakage,
        sensor_filter,
        feedthrough,
        mains_hum,
        transport_delay,
        clock_skew,
        sensor_dropout,
        quantisation,
    )
}

__all__ = ["EFFECTS", "Context", "Effect", "Location", "Parameter", "Search", "Values"]
