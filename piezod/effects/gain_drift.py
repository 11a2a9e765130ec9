"""The sensitivity of the stack changes during the record, by depolarisation, ageing or self-heating.

Forward    x (1 + relative_change g(q)); g(q) = (1 - exp(-b q)) / (1 - exp(-b)), b is the bend;
           q = p - s sin(2 pi p) / (2 pi), s is the s_shape; p = t / duration.
Inverse    Divide by 1 + relative_change, the constant gain at the end of the record. Identify again when it changes.
Signature  The same loop grows or shrinks in proportion to itself, time after time. Look-alikes: thermal_drift and creep
           add a term that does not scale with the loop.
Location   Stack, in front of the force law.
Valid      Records with several loops of one amplitude. A simulation of another record changes by the same amount from
           its start to its end.
Source     Physik Instrumente (2005), Designing with Piezoelectric Transducers, ageing. The time course: chosen here;
           straight for b = s = 0, late for b < 0, steepest at the ends for s < 0;
           piezod/effects/README.md, "Gain drift".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values, all_the_time
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting

SMALLEST_BEND = 1e-3  # a smaller bend counts as 0


@numba.njit(cache=True, nogil=True)
def changed_share(part: float, bend: float, s_shape: float) -> float:
    """Share g of the change at a part p of the record, 0 to 1; 0 before the record and 1 after it.

    Parameters
    ----------
    part
        Time since the first sample as a part of the duration of the record [1].
    bend
        Curvature of the exponential course [1]; 0: straight.
    s_shape
        Amplitude of the sine in the course [1]; 0: none.
    """
    part = min(max(part, 0.0), 1.0)
    if s_shape != 0.0:
        part -= s_shape * math.sin(2.0 * math.pi * part) / (2.0 * math.pi)
    return part if abs(bend) < SMALLEST_BEND else math.expm1(-bend * part) / math.expm1(-bend)


@numba.njit(cache=True, nogil=True)
def _run(x: Array, time_s: Array, duration_s: float, change: float, bend: float, s_shape: float) -> Array:
    out = np.empty(x.size)
    for k in range(x.size):
        out[k] = x[k] * (1.0 + change * changed_share(time_s[k] / duration_s, bend, s_shape))
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Stroke with the present sensitivity, shape (N,) [V].

    `signal` is the stroke [V]. Parameters as in `piezod.effects.effect.Forward`.
    """
    shape = (values.get("bend", 0.0), values.get("s_shape", 0.0))
    out: Array = _run(signal, context.time_s, context.duration_s, values["relative_change"], *shape)
    return out


def _memory(values: Values, _setting: TickSetting) -> Array:
    """Gain at the end of the drift: a drive comes after the recording."""
    return np.array([1.0 + values["relative_change"]])


def _advance(own: Memory, _shared: Memory, stroke_V: float) -> float:
    return own[0] * stroke_V


def _invert(own: Memory, _shared: Memory, stroke_V: float) -> float:
    return stroke_V / own[0]


EFFECT = Effect(
    name="gain_drift",
    title="drift of the sensitivity",
    location=Location.STACK,
    form="scaling",
    parameters=(
        Parameter("relative_change", "1", -0.5, 1.0, Search((-0.02,))),
        Parameter("bend", "1", -5.0, 20.0, Search((1.0,), nuisance=True)),
        Parameter("s_shape", "1", -1.0, 1.0, Search((0.0,), nuisance=True), optional=True),
    ),
    forward=forward,
    handling="compensated",
    tick=Tick(_memory, _advance, _invert),
    docstring=__doc__,
    separate_by="the same reset cycle at the beginning and at the end, at one temperature",
    place=all_the_time,
    flexible=True,
    checks=Checks(constant="varies"),
)
