"""From the commands to the free stroke of the stack: amplifier, hysteresis, creep, drift of the gain."""

import numpy as np

from firmware_sim.concealed.plant.amplifier import clamp, slew, swelling_lag
from firmware_sim.concealed.plant.arrays import Array
from firmware_sim.concealed.plant.creep import creep_response, curve
from firmware_sim.concealed.plant.hysteresis import Hysteresis
from firmware_sim.concealed.plant.record_context import Effect, RecordContext, Signal

RATE_LAWS = ("logarithmic", "linear", "averaged")
YIELDING = ("linear", "averaged")  # laws whose widths follow the rate at rest too
DRIFT_SHAPES = ("bent", "logarithmic", "sigmoid")
SLEW_TAU = 0.02  # time constant below the slew limit [samples]


def output_voltage(context: RecordContext) -> Signal:
    """Voltage at the stack, on the fine grid [V].

    Parameters
    ----------
    context
        Drive and active effects of the record.
    """
    drive, held = context.drive, context.drive.held
    voltage_V = drive.fine_voltage_V()
    if on := context.on("voltage_clamp"):
        voltage_V = clamp(voltage_V, on.parameters["limit_V"], on.number("knee_V"))
    if on := context.on("slew_limit"):
        tau_s = SLEW_TAU / drive.rate_Hz
        voltage_V = slew(voltage_V, on.parameters["limit_V_per_s"], tau_s, drive.fine_s, held)
        held = False
    if on := context.on("electrical_lag"):
        tau_s, swell = on.parameters["time_constant_s"], on.number("swell")
        voltage_V = swelling_lag(voltage_V, tau_s, swell, context.reach_V, drive.fine_s, held)
        held = False
    return Signal(context.with_foreign("amplifier", voltage_V), held)


def hysteretic_stroke(context: RecordContext, core: Hysteresis, noncongruent: Hysteresis, voltage: Signal) -> Signal:
    """Stroke behind the hysteresis, on the fine grid, expressed in volts [V].

    Parameters
    ----------
    context
        Drive and active effects of the record.
    core
        Operator of the plant.
    noncongruent
        Operator of the effect `noncongruent_minor_loops`.
    voltage
        Voltage at the stack, on the fine grid [V].
    """
    voltage_V, widening, other = voltage.values, None, None
    if on := context.on("rate_dependent_hysteresis"):
        grown = on.parameters["growth"] * _rate_measure(context, on, voltage_V)
        if on.details.get("law") in YIELDING:
            other = core.lagging(voltage_V, 1.0 + grown, yields_at_rest=True)
        else:
            widening = 1.0 + grown
    if on := context.on("noncongruent_minor_loops"):
        share = on.parameters["share"]
        other = (1.0 - share) * core.lagging(voltage_V, widening) + share * noncongruent.lagging(voltage_V)
    return Signal(core.run(voltage_V, widening=widening, other=other), voltage.held)


def free_stroke(context: RecordContext, stroke: Signal) -> Signal:
    """Stroke with creep and drift of the gain, on the fine grid [V].

    Parameters
    ----------
    context
        Drive and active effects of the record.
    stroke
        Stroke behind the hysteresis, on the fine grid [V].
    """
    values = stroke.values
    if on := context.on("creep"):
        response = curve(on.text("law"), on.number("shape"), on.parameters["from_s"], on.parameters["to_s"])
        values = values + on.parameters["per_decade"] * creep_response(values, response, context.drive.fine_s)
    if on := context.on("gain_drift"):
        part = context.time_s(values.size) / context.drive.time_s[-1]
        values = values * (
            1.0 + on.parameters["relative_change"] * drift_progress(on.text("course"), on.number("bend"), part)
        )
    return Signal(context.with_foreign("stack", values), stroke.held)


def drift_progress(shape: str, bend: float, part: Array) -> Array:
    """Share of a drift that is complete, from 0 to 1 over a record, shape (n,).

    Parameters
    ----------
    shape
        One of `DRIFT_SHAPES`: a power of time, a logarithm of time, or a sigmoid.
    bend
        Departure from a straight line, 0 to 1.
    part
        Relative time in the record, shape (n,), 0 to 1.
    """
    if shape == "bent":
        power: Array = part ** (1.0 + 0.7 * (bend - 0.5))
        return power
    if shape == "logarithmic":
        reach = 0.2 + 6.0 * bend
        logarithm: Array = np.log1p(reach * part) / np.log1p(reach)
        return logarithm
    steep = 0.5 + 3.0 * bend
    sigmoid: Array = 0.5 + 0.5 * np.tanh(steep * (part - 0.5)) / np.tanh(0.5 * steep)
    return sigmoid


def _rate_measure(context: RecordContext, on: Effect, voltage_V: Array) -> Array:
    """Function of the rate that the widths grow with, shape (n,) [1]."""
    rate, law = _rate_V_per_s(context, voltage_V), on.details.get("law", "logarithmic")
    if law in YIELDING:
        rate = _mean_of_the_last(rate, max(round(on.number("window_s") / context.drive.fine_s), 1))
    if law == "linear":
        return rate / on.number("fastest_V_per_s")
    result: Array = np.arcsinh(rate / on.parameters["reference_V_per_s"])
    return result


def _mean_of_the_last(values: Array, count: int) -> Array:
    """Mean of every value and those before it, `count` in all, shape (n,); before the first they are 0."""
    sums = np.concatenate((np.zeros(count), np.cumsum(values)))
    result: Array = (sums[count:] - sums[:-count]) / count
    return result


def _rate_V_per_s(context: RecordContext, voltage_V: Array) -> Array:
    """Rate of the voltage over the last sample period, shape (n,) [V/s]."""
    back = context.drive.substeps
    before = np.concatenate((np.full(back, voltage_V[0]), voltage_V[:-back]))
    result: Array = np.abs(voltage_V - before) * context.drive.rate_Hz
    return result
