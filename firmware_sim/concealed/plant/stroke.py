"""From the commands to the stack's free stroke: amplifier, hysteresis, creep, a gain that drifts."""

import numpy as np

from firmware_sim.concealed.plant.amplifier import clamp, slew, swelling_lag
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.creep import crept, curve
from firmware_sim.concealed.plant.hysteresis import Hysteresis
from firmware_sim.concealed.plant.passage import Passage, Signal

COURSES = ("bent", "logarithmic", "sigmoid")
SLEW_TAU = 0.02  # samples: how long the amplifier takes to follow what is no limit


def output_voltage(at: Passage) -> Signal:
    """Voltage at the stack, on the fine grid [V]."""
    drive, stairs = at.drive, at.drive.held
    voltage_V = drive.fine_voltage_V()
    if on := at.on("voltage_clamp"):
        voltage_V = clamp(voltage_V, on.parameters["limit_V"], on.number("knee_V"))
    if on := at.on("slew_limit"):
        tau_s = SLEW_TAU / drive.rate_Hz
        voltage_V = slew(voltage_V, on.parameters["limit_V_per_s"], tau_s, drive.fine_s, stairs)
        stairs = False
    if on := at.on("electrical_lag"):
        tau_s, swell = on.parameters["time_constant_s"], on.number("swell")
        voltage_V = swelling_lag(voltage_V, tau_s, swell, at.reach_V, drive.fine_s, stairs)
        stairs = False
    return Signal(at.with_foreign("amplifier", voltage_V), stairs)


def hysteretic_stroke(at: Passage, core: Hysteresis, noncongruent: Hysteresis, voltage: Signal) -> Signal:
    """Stroke in volts' worth behind the hysteresis [V]."""
    voltage_V, widening, other = voltage.values, None, None
    if on := at.on("rate_dependent_hysteresis"):
        rate = _rate_V_per_s(at, voltage_V) / on.parameters["reference_V_per_s"]
        widening = 1.0 + on.parameters["growth"] * np.arcsinh(rate)
    if on := at.on("noncongruent_minor_loops"):
        share = on.parameters["share"]
        other = (1.0 - share) * core.lagging(voltage_V, widening) + share * noncongruent.lagging(voltage_V)
    return Signal(core.run(voltage_V, widening=widening, other=other), voltage.stairs)


def free_stroke(at: Passage, stroke: Signal) -> Signal:
    """Stroke with creep and drift [V]."""
    values = stroke.values
    if on := at.on("creep"):
        response = curve(on.text("law"), on.number("shape"), on.parameters["from_s"], on.parameters["to_s"])
        values = values + on.parameters["per_decade"] * crept(values, response, at.drive.fine_s)
    if on := at.on("gain_drift"):
        part = at.time_s(values.size) / at.drive.time_s[-1]
        values = values * (1.0 + on.parameters["relative_change"] * course(on.text("course"), on.number("bend"), part))
    return Signal(at.with_foreign("stack", values), stroke.stairs)


def course(kind: str, bent: float, part: Array) -> Array:
    """How much of a drift has come about, from 0 to 1, at parts of a record, shape (n,).

    Parameters
    ----------
    kind
        One of `COURSES`: a power of time, a logarithm, or slow at both ends.
    bent
        0 to 1: how much it departs from a straight line.
    part
        Shape (n,); 0 at the beginning, 1 at the end.
    """
    if kind == "bent":
        power: Array = part ** (1.0 + 0.7 * (bent - 0.5))
        return power
    if kind == "logarithmic":
        reach = 0.2 + 6.0 * bent
        logarithm: Array = np.log1p(reach * part) / np.log1p(reach)
        return logarithm
    steep = 0.5 + 3.0 * bent
    sigmoid: Array = 0.5 + 0.5 * np.tanh(steep * (part - 0.5)) / np.tanh(0.5 * steep)
    return sigmoid


def _rate_V_per_s(at: Passage, voltage_V: Array) -> Array:
    """Rate of the voltage over the last sample period, shape (n,) [V/s]."""
    back = at.drive.substeps
    before = np.concatenate((np.full(back, voltage_V[0]), voltage_V[:-back]))
    result: Array = np.abs(voltage_V - before) * at.drive.rate_Hz
    return result
