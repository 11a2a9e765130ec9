"""The stack goes on moving after a step, with the logarithm of time.

Forward    x + sum_j c_j y_j, tau_j y_j' = x - x(0) - y_j: a Kelvin-Voigt chain, four elements a decade
Inverse    subtract the states, then advance them: exact (derived here)
Signature  a hold keeps moving towards the last step, straight in log t, in proportion to the step; loops open alike at
           every frequency, so plays absorb it; look-alikes thermal_drift (not after steps), charge_leakage (to zero)
Seat       stack, behind the plays and in front of the force law
Valid      holds of a decade and more between from_s and to_s, at least 3 from_s; without holds it hides in the plays
Source     Physik Instrumente (2005), Designing with Piezoelectric Transducers, creep; Jung and Gweon (2000), Creep
           Characteristics of Piezoelectric Actuators; weights of the end elements derived here;
           piezod/effects/README.md, "Creep"
"""

import math

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import chain_run

A_DECADE = 4  # elements
NARROWEST = 3.0  # to_s over from_s
FIRST_EXTRA, LAST_EXTRA = 0.596, 1.260  # what the end elements stand for besides, in natural logarithms of time
PLAYS, VOLTAGE = 0, 1  # what drives it


def spectrum(from_s: float, to_s: float, slope: float = 0.0, seen_s: float = math.inf) -> tuple[Array, Array]:
    """Time constants [s] and weights (1) of the chain whose step response climbs by 1 a decade from `from_s` to `to_s`.

    Weights go with tau^slope about the middle of what a record of `seen_s` shows of that span. With slope 0 the
    response is straight up to the ends: a flat density from one to the other would come short there by E1(1) = 0.219
    and Ein(1) = 0.797 in all, so the first and the last element weigh 0.219 / (1 / e) and 0.797 / (1 - 1 / e) more.
    """
    to_s = max(to_s, NARROWEST * from_s)
    decades = math.log10(to_s / from_s)
    count = max(3, math.ceil(A_DECADE * decades) + 1)
    tau_s = np.geomspace(from_s, to_s, count)
    weights = np.full(count, math.log(to_s / from_s) / (count - 1))
    weights[0] = 0.5 * weights[0] + FIRST_EXTRA
    weights[-1] = 0.5 * weights[-1] + LAST_EXTRA
    climbed = float(weights @ (np.exp(-from_s / tau_s) - np.exp(-to_s / tau_s)))
    middle_s = math.sqrt(from_s * max(min(to_s, seen_s), NARROWEST * from_s))
    return tau_s, weights * decades / climbed * (tau_s / middle_s) ** slope


def forward(signal: Array, context: Context, values: Values) -> Array:
    """What the plays give and what crept since the first sample, shape (N,) [V]."""
    seen_s = context.seen_s or context.duration_s
    tau_s, weights = spectrum(values["from_s"], values["to_s"], values.get("slope", 0.0), seen_s)
    driver = signal
    if round(values.get("driven_by", PLAYS)) == VOLTAGE:
        driver = _as_large_as(signal, context.applied_V)
    crept = chain_run(driver, tau_s, values["per_decade"] * weights, context.dt_s, context.hold.number)
    out: Array = signal + crept
    return out


def _as_large_as(signal: Array, voltage_V: Array) -> Array:
    """Voltage scaled to the signal by least squares, both from their first samples: still linear in the signal."""
    voltage = voltage_V - voltage_V[0]
    power = float(voltage @ voltage)
    scaled: Array = voltage * (float(voltage @ (signal - signal[0])) / power if power > 0.0 else 0.0)
    return scaled


EFFECT = Effect(
    name="creep",
    title="creep of the stack",
    seat=Seat.STACK,
    form="linear",
    parameters=(
        Parameter("per_decade", "1", 0.0, 0.3, starts=(0.01,)),
        Parameter("from_s", "s", 1e-3, 10.0, starts=(0.1,), logarithmic=True),
        Parameter("to_s", "s", 1.0, 1e5, starts=(1000.0, 30.0), logarithmic=True),
        Parameter("slope", "1", -0.15, 0.15, starts=(0.0,), nuisance=True),
        Parameter("driven_by", "1", 0.0, 1.0, starts=(0.0,), nuisance=True, choices=(0.0, 1.0)),
    ),
    forward=forward,
    handling="compensated",
    docstring=__doc__,
    separate_by="a staircase with holds of three decades of time, up and down",
)
