"""The force law bends beyond the identified one, because a contact stiffens or the material saturates.

Forward    F + curvature F^2 / span + cubic F^2 (F - span) / span^2. It is straight where its slope would be below 0.05.
           curvature is the change of the force at the upper end, as a part of the span.
Inverse    Exact: the force at which the increasing law has the wanted value.
Signature  An error that depends on the force alone, equal on both branches. Look-alikes: voltage_clamp is flat at one
           voltage, contact_gap is flat at the bottom.
Location   Mechanics.
Valid      Forces up to half of the identified span beyond it. A model that was fitted with it has absorbed it.
Source     K. Kuhnen (2003), Modeling, Identification and Compensation of Complex Hysteretic Nonlinearities, European
           Journal of Control 9(4), saturation. K. L. Johnson (1985), Contact Mechanics. The polynomial and its straight
           continuation: derived here; piezod/effects/README.md, "Output nonlinearity".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting

LEAST_SLOPE = 0.05  # the law is straight where the polynomial would be flatter


@numba.njit(cache=True, nogil=True)
def law_step(part: float, square: float, cube: float, low: float, high: float) -> float:
    """Force behind the law for the force `part`, both in spans; `low` to `high` is the interval of `rising`.

    Parameters
    ----------
    part
        Force, as a part of the span.
    square, cube
        Coefficients of part^2 and part^3 [1].
    low, high
        Interval of `rising`; outside it the law is straight.
    """
    inside = min(max(part, low), high)
    return inside + inside * inside * (square + cube * inside) + LEAST_SLOPE * (part - inside)


@numba.njit(cache=True, nogil=True)
def _run(force: Array, span: float, square: float, cube: float, low: float, high: float) -> Array:
    out = np.empty(force.size)
    for k in range(force.size):
        out[k] = span * law_step(force[k] / span, square, cube, low, high)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:
    """Force behind the changed law, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    cube = values.get("cubic", 0.0)
    square = values["curvature"] - cube
    return _run(signal, context.force_span_N, square, cube, *rising(square, cube))


def rising(square: float, cube: float) -> tuple[float, float]:
    """Interval around zero in which 1 + 2 square x + 3 cube x^2 is above `LEAST_SLOPE`.

    Parameters
    ----------
    square, cube
        Coefficients of x^2 and x^3 in the law x + square x^2 + cube x^3 [1].

    Returns
    -------
    Lower end, below 0, and upper end, above 0; infinite where the slope stays above `LEAST_SLOPE`.
    """
    a, b, c = 3.0 * cube, 2.0 * square, 1.0 - LEAST_SLOPE
    roots: list[float] = []
    if b * b >= 4.0 * a * c and (a != 0.0 or b != 0.0):
        q = -0.5 * (b + math.copysign(math.sqrt(b * b - 4.0 * a * c), b))  # both roots without cancellation
        roots = [c / q] + ([q / a] if a != 0.0 else [])
    below, above = [x for x in roots if x < 0.0], [x for x in roots if x > 0.0]
    return max(below, default=-math.inf), min(above, default=math.inf)


SPAN_N, SQUARE, CUBE, LOW, HIGH = range(5)  # memory
BISECTIONS = 60


def _memory(values: Values, setting: TickSetting) -> Array:
    cube = values.get("cubic", 0.0)
    square = values["curvature"] - cube
    return np.array([setting.force_span_N, square, cube, *rising(square, cube)])


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    return own[SPAN_N] * law_step(force_N / own[SPAN_N], own[SQUARE], own[CUBE], own[LOW], own[HIGH])


def _invert(own: Memory, _shared: Memory, force_N: float) -> float:
    """Force in front of the law, by bisection of the rising function."""
    aim = force_N / own[SPAN_N]
    low, high = aim - 1.0, aim + 1.0
    while law_step(low, own[SQUARE], own[CUBE], own[LOW], own[HIGH]) > aim:
        low -= 2.0 * (high - low)
    while law_step(high, own[SQUARE], own[CUBE], own[LOW], own[HIGH]) < aim:
        high += 2.0 * (high - low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if law_step(middle, own[SQUARE], own[CUBE], own[LOW], own[HIGH]) < aim:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high) * own[SPAN_N]


EFFECT = Effect(
    name="output_nonlinearity",
    title="curved force law",
    location=Location.MECHANICS,
    form="memoryless",
    parameters=(
        Parameter("curvature", "1", -0.8, 0.8, Search((0.03, -0.03))),
        Parameter("cubic", "1", -0.2, 0.2, Search((0.0,), nuisance=True)),
    ),
    forward=forward,
    handling="compensated",
    tick=Tick(_memory, _advance, _invert),
    docstring=__doc__,
    separate_by="slow triangles about several biases, and again with another preload",
    flexible=True,
    checks=Checks(constant="shifted"),
)
