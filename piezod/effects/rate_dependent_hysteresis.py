"""The plays grow wider at a higher rate of the voltage.

Forward    r_i(t) = r_i (1 + growth ln(1 + rate / reference)). rate is |du/dt|, smoothed over a short distance of u, so
           that it keeps its value while u rests; or over a short time, so that it falls. Two other laws are tried: a
           power of the rate, and one offset for all r_i.
Inverse    Implicit, with the thresholds of the present rate. It is exact for thresholds of any time course
           (piezod/operators/README.md, "Thresholds that change with time").
Signature  Loops widen with the logarithm of the rate, the flat after a reversal grows longer, a hold shows nothing.
           Look-alikes: electrical_lag widens in proportion to the rate and rounds corners, creep continues in a hold.
Location   Hysteresis: it changes the thresholds of the plays.
Valid      At least one decade of rates. r_0 = 0 has no width and does not grow.
Source     M. Al Janaideh and P. Krejci (2013), Inverse Rate-Dependent Prandtl-Ishlinskii Model, IEEE/ASME Transactions
           on Mechatronics 18(5), 1498-1507, thresholds that depend on the rate. The logarithm: chosen here;
           piezod/effects/README.md, "Rate-dependent hysteresis".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values, unchanged
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import SHARED, Memory, Tick, TickSetting

LOGARITHM, POWER, OFFSET = 0, 1, 2  # values of `kind`
DISTANCE, TIME = 0.0, 1.0  # values of `rate_over`: what the rate is smoothed over
USUAL_MEMORY_s = 0.005
OFFSET_SHARE = 0.1  # OFFSET: growth 1 adds this share of the voltage range to every threshold
USUAL_DISTANCE_V = 2.0  # distance of the voltage over which the rate is smoothed, as on a usual stack
PAUSE_s = 0.05  # a shorter rest is part of the movement (a held command); a longer one is a hold


@numba.njit(cache=True, nogil=True)
def rate_step(
    rate: float, rested_s: float, moved_V: float, dt_s: float, distance_V: float, memory_s: float
) -> tuple[float, float]:
    """Smoothed rate and time at rest, one sample later.

    Smoothed over a distance, the rate keeps its value at rest. Smoothed over a time, it falls there.

    Parameters
    ----------
    rate
        Smoothed rate [V/s], at least 0.
    rested_s
        Time since the voltage last changed [s].
    moved_V
        |du| in this sample [V].
    dt_s
        Spacing of the samples [s].
    distance_V
        Distance of the voltage over which the rate is smoothed [V], above 0.
    memory_s
        Time over which it is smoothed instead [s]; 0: it is smoothed over the distance.

    Returns
    -------
    rate, rested_s
        The same after the sample [V/s, s].
    """
    rested_s += dt_s
    if memory_s > 0.0:
        return rate - (moved_V / dt_s - rate) * math.expm1(-dt_s / memory_s), 0.0
    if moved_V == 0.0:
        return rate, rested_s
    duration_s = rested_s if rested_s <= PAUSE_s else dt_s
    return rate - (moved_V / duration_s - rate) * math.expm1(-moved_V / distance_V), 0.0


@numba.njit(cache=True, nogil=True)
def widening_step(rate: float, growth: float, reference: float, kind: float) -> tuple[float, float]:
    """Factor of the thresholds [1], and their offset in parts of the offset at a growth of 1 [1].

    Parameters
    ----------
    rate, reference
        Smoothed rate and reference rate [V/s].
    growth
        Growth per e-fold of the rate [1].
    kind
        LOGARITHM, POWER or OFFSET.
    """
    wider = growth * math.log1p(rate / reference)
    if kind == OFFSET:
        return 1.0, wider
    return math.exp(wider) if kind == POWER else 1.0 + wider, 0.0


@numba.njit(cache=True, nogil=True)
def _run(
    u: Array, dt_s: float, distance_V: float, memory_s: float, growth: float, reference: float, kind: float
) -> tuple[Array, Array]:
    factor, offset = np.ones(u.size), np.zeros(u.size)
    rate, rested_s = 0.0, 0.0
    for k in range(1, u.size):
        rate, rested_s = rate_step(rate, rested_s, abs(u[k] - u[k - 1]), dt_s, distance_V, memory_s)
        factor[k], offset[k] = widening_step(rate, growth, reference, kind)
    return factor, offset


def widening(context: Context, values: Values) -> tuple[Array, Array]:
    """Factor [1] and offset [V] of all thresholds above 0, each of shape (N,).

    Parameters as in `piezod.effects.effect.Widening`.
    """
    u = context.applied_V
    kind = round(values.get("kind", LOGARITHM))
    memory_s = values["rate_memory_s"] if round(values.get("rate_over", DISTANCE)) == TIME else 0.0
    distance_V, growth = values.get("rate_way_V", USUAL_DISTANCE_V), values["growth"]
    factor, offset = _run(u, context.dt_s, distance_V, memory_s, growth, values["reference_V_per_s"], kind)
    return factor, OFFSET_SHARE * context.voltage_span_V * offset


GROWTH, KIND, REFERENCE, WAY_V, MEMORY_S, OFFSET_V, PERIOD_S, RATE, RESTED_S = range(9)  # memory


def _memory(values: Values, setting: TickSetting) -> Array:
    over_time = round(values.get("rate_over", DISTANCE)) == TIME
    return np.array(
        [
            values["growth"],
            round(values.get("kind", LOGARITHM)),
            values["reference_V_per_s"],
            values.get("rate_way_V", USUAL_DISTANCE_V),
            values["rate_memory_s"] if over_time else 0.0,
            OFFSET_SHARE * setting.voltage_span_V,
            setting.dt_s,
            0.0,
            0.0,
        ]
    )


def _widen(own: Memory, shared: Memory, applied_V: float) -> float:
    """Widen the thresholds for a tick that ends at `applied_V` [V], without a change of the states."""
    moved_V = abs(applied_V - shared[SHARED.before_V])
    rate, _ = rate_step(own[RATE], own[RESTED_S], moved_V, own[PERIOD_S], own[WAY_V], own[MEMORY_S])
    factor, offset = widening_step(rate, own[GROWTH], own[REFERENCE], own[KIND])
    shared[SHARED.factor] *= factor
    shared[SHARED.offset_V] += own[OFFSET_V] * offset
    return applied_V


def _advance(own: Memory, shared: Memory, applied_V: float) -> float:
    moved_V = abs(applied_V - shared[SHARED.before_V])
    rate, rested_s = rate_step(own[RATE], own[RESTED_S], moved_V, own[PERIOD_S], own[WAY_V], own[MEMORY_S])
    own[RATE], own[RESTED_S] = rate, rested_s
    factor, offset = widening_step(rate, own[GROWTH], own[REFERENCE], own[KIND])
    shared[SHARED.factor] *= factor
    shared[SHARED.offset_V] += own[OFFSET_V] * offset
    return applied_V


def _settle(own: Memory, _shared: Memory, _applied_V: float) -> float:
    own[RATE] = own[RESTED_S] = 0.0
    return 0.0


EFFECT = Effect(
    name="rate_dependent_hysteresis",
    title="hysteresis that grows with the rate",
    location=Location.HYSTERESIS,
    form="other",
    parameters=(
        Parameter("growth", "1", 0.0, 1.0, Search((0.05,))),
        Parameter(
            "reference_V_per_s",
            "V/s",
            0.1,
            1e4,
            Search(
                (3.0,),
                lambda driven: (0.1 * driven.usual_V_per_s, driven.usual_V_per_s, driven.fast_V_per_s),
                logarithmic=True,
            ),
            shown_by=lambda driven: (0.03 * driven.slow_V_per_s, 3.0 * driven.fastest_V_per_s),
        ),
        Parameter(
            "rate_way_V",
            "V",
            0.01,
            200.0,
            Search((USUAL_DISTANCE_V,), logarithmic=True, nuisance=True, only_if=("rate_over", DISTANCE)),
        ),
        Parameter(
            "rate_memory_s",
            "s",
            1e-5,
            1.0,
            Search((USUAL_MEMORY_s,), logarithmic=True, nuisance=True, only_if=("rate_over", TIME)),
        ),
        Parameter("rate_over", "1", 0.0, 1.0, Search((0.0,), nuisance=True, choices=(DISTANCE, TIME))),
        Parameter("kind", "1", 0.0, 2.0, Search((0.0,), nuisance=True, choices=(0.0, 1.0, 2.0))),
    ),
    forward=unchanged,
    widening=widening,
    handling="compensated",
    tick=Tick(_memory, _advance, _widen, _settle),
    docstring=__doc__,
    separate_by="triangles of one amplitude over three decades of frequency, with a hold behind each corner",
    flexible=True,
    checks=Checks(values={"growth": 0.1, "rate_way_V": 8.0}),
)
