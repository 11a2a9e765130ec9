"""The stack's sensitivity changes over the record: depolarisation, ageing, self-heating.

Forward    x (1 + relative_change g(q)), p = t / duration, q = p - s sin(2 pi p) / (2 pi) sets in and ends gently,
           g(q) = (1 - exp(-b q)) / (1 - exp(-b)) levels off with the bend b
Inverse    divide by the gain of the moment: a schedule, renewed by a reset cycle
Signature  the same loop grows or shrinks in proportion to itself, time after time; look-alikes thermal_drift and creep
           add something that does not scale with the loop
Seat       stack, in front of the force law
Valid      records of several loops of one amplitude; another record is taken to change as much from end to end
Source     Physik Instrumente (2005), Designing with Piezoelectric Transducers, ageing; the course chosen here: straight
           for b = s = 0, late for b < 0, steepest at the ends for s < 0; piezod/effects/README.md, "Gain drift"
"""

import math

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values

STRAIGHT_ON = 1e-3  # bends below it


@numba.njit(cache=True, nogil=True)
def course(part: float, bend: float, s_shape: float) -> float:
    """Share of the change that has come about at a part of the record; 0 before it, 1 behind it."""
    part = min(max(part, 0.0), 1.0)
    part -= s_shape * math.sin(2.0 * math.pi * part) / (2.0 * math.pi)
    if abs(bend) < STRAIGHT_ON:
        return part
    return math.expm1(-bend * part) / math.expm1(-bend)


@numba.njit(cache=True, nogil=True)
def _run(x: Array, time_s: Array, duration_s: float, change: float, bend: float, s_shape: float) -> Array:
    out = np.empty(x.size)
    for k in range(x.size):
        out[k] = x[k] * (1.0 + change * course(time_s[k] / duration_s, bend, s_shape))
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """What the plays give with the sensitivity of the moment, shape (N,) [V]."""
    shape = (values.get("bend", 0.0), values.get("s_shape", 0.0))
    out: Array = _run(signal, context.time_s, context.duration_s, values["relative_change"], *shape)
    return out


EFFECT = Effect(
    name="gain_drift",
    title="drift of the sensitivity",
    seat=Seat.STACK,
    form="linear",
    parameters=(
        Parameter("relative_change", "1", -0.5, 1.0, starts=(-0.02,)),
        Parameter("bend", "1", -5.0, 20.0, starts=(1.0,), nuisance=True),
        Parameter("s_shape", "1", -1.0, 1.0, starts=(0.0,), nuisance=True, may_lack=True),
    ),
    forward=forward,
    handling="compensated",
    docstring=__doc__,
    separate_by="the same reset cycle at the beginning and at the end, at one temperature",
)
