"""The output resistance R of the amplifier and the capacitance C of the stack form a first-order lag.

Forward    tau du'/dt = u - u', tau = R C, exact for a straight and for a held voltage. C may grow with the voltage:
           tau = time_constant (1 + swell (u' - 60 V) / 100 V), with u' at the start of each sample.
Inverse    u = u' + tau du'/dt. For a held command the wanted voltage is reached at the end of the tick (derived here).
Signature  Loops widen in proportion to the rate and corners are rounded; a rest shows nothing. Look-alikes:
           sensor_filter also shapes the noise, transport_delay keeps corners, slew_limit acts above a rate only.
Location   Amplifier, in front of the hysteresis.
Valid      0.1 ms to 0.5 s. Below 1.5 samples it is indistinguishable from a filter or a delay.
Source     Derived here, for R of 10 to 1000 ohm and C of 0.1 to 10 uF. The linear growth of C: chosen here.
           piezod/effects/README.md, "Electrical lag".
"""

import math

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import LATE, Checks, Context, Effect, Location, Values
from piezod.effects.kernels import (
    first_order_coefficients,
    first_order_run,
    first_order_step,
    time_constant_at,
    voltage_dependent_lag_run,
)
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import SHARED, Memory, Tick, TickSetting


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Voltage at the stack, shape (N,) [V].

    `signal` is the voltage [V]. Parameters as in `piezod.effects.effect.Forward`.
    """
    swell = values.get("swell", 0.0)
    if swell == 0.0:
        return first_order_run(signal, values["time_constant_s"], context.dt_s, context.hold.number)
    out: Array = voltage_dependent_lag_run(signal, values["time_constant_s"], swell, context.dt_s, context.hold.number)
    return out


TAU_S, SWELL, PERIOD_S, COMMAND_V, VOLTAGE_V = range(5)  # memory: constants; voltage before and behind the lag


def _memory(values: Values, setting: TickSetting) -> Array:
    return np.array([values["time_constant_s"], values.get("swell", 0.0), setting.dt_s, 0.0, 0.0])


def _advance(own: Memory, shared: Memory, voltage_V: float) -> float:
    tau_s = time_constant_at(own[VOLTAGE_V], own[TAU_S], own[SWELL])
    keep, ramp = first_order_coefficients(tau_s, own[PERIOD_S], 1.0 - shared[SHARED.runs_straight])
    own[VOLTAGE_V] = first_order_step(own[VOLTAGE_V], own[COMMAND_V], voltage_V, keep, ramp)
    own[COMMAND_V] = voltage_V
    return own[VOLTAGE_V]


def _invert(own: Memory, _shared: Memory, voltage_V: float) -> float:
    """Command, held for the tick, that ends at a voltage."""
    tau_s = time_constant_at(own[VOLTAGE_V], own[TAU_S], own[SWELL])
    keep, _ = first_order_coefficients(tau_s, own[PERIOD_S], 1.0)
    return own[VOLTAGE_V] + (voltage_V - own[VOLTAGE_V]) / (1.0 - keep)


def _settle(own: Memory, _shared: Memory, voltage_V: float) -> float:
    own[COMMAND_V] = own[VOLTAGE_V] = voltage_V
    return voltage_V


def _risen(values: Values, dt_s: float, into: float) -> float:
    """Share of a tick's step that has arrived at the fraction f of it: (1 - e^(-f T / tau)) / (1 - e^(-T / tau))."""
    tau_s = values["time_constant_s"]
    return math.expm1(-into * dt_s / tau_s) / math.expm1(-dt_s / tau_s)


EFFECT = Effect(
    name="electrical_lag",
    title="electrical lag of the amplifier",
    location=Location.AMPLIFIER,
    form="other",
    parameters=(
        Parameter("time_constant_s", "s", 1e-4, 0.5, Search((3e-3, 3e-2), logarithmic=True)),
        Parameter("swell", "1", -0.2, 1.0, Search((0.0,), nuisance=True), optional=True),
    ),
    forward=forward,
    handling="compensated",
    smooths=True,
    tick=Tick(_memory, _advance, _invert, _settle, risen=_risen),
    docstring=__doc__,
    separate_by="the amplifier's monitor output recorded as well, or triangles at 1 and 10 Hz about two biases",
    plausible=lambda values, record: values["time_constant_s"] >= LATE * record.dt_s,
    checks=Checks(values={"time_constant_s": 0.05}),
)
