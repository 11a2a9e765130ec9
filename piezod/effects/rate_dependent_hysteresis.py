"""The plays grow wider with the rate of the voltage.

Forward    r_i(t) = r_i (1 + growth ln(1 + rate / reference)); rate is |du/dt|, smoothed over a short way of u and so
           kept while u rests
Inverse    implicit, with the thresholds of this rate; exact for any schedule of thresholds
           (piezod/operators/README.md, "Thresholds that change with time")
Signature  loops widen with the logarithm of the rate, flats after a reversal lengthen, nothing relaxes in a hold;
           look-alike electrical_lag widens in proportion to the rate and rounds corners, creep goes on in a hold
Seat       the hysteresis itself
Valid      one decade of rates at least; r_0 = 0 has no width that could grow
Source     Al Janaideh and Krejci (2013), IEEE/ASME Trans. Mechatronics 18(5), 1498-1507: thresholds that depend on the
           rate; the logarithm chosen here; piezod/effects/README.md, "Rate-dependent hysteresis"
"""

import math

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values, unchanged

LOGARITHM, POWER, OFFSET = 0, 1, 2
OFFSET_SHARE = 0.1  # of the voltage range: what growth is measured in where all thresholds grow alike
USUAL_WAY_V = 2.0
PAUSE_s = 0.05  # a shorter rest belongs to the movement (a held command), a longer one is a hold


@numba.njit(cache=True, nogil=True)
def rate_step(rate: float, rested_s: float, moved_V: float, dt_s: float, way_V: float) -> tuple[float, float]:
    """Advance the smoothed rate [V/s] and the time since the voltage last moved [s] by a sample of |du| = `moved_V`."""
    rested_s += dt_s
    if moved_V == 0.0:
        return rate, rested_s
    taken = rested_s if rested_s <= PAUSE_s else dt_s
    return rate - (moved_V / taken - rate) * math.expm1(-moved_V / way_V), 0.0


@numba.njit(cache=True, nogil=True)
def _rates(u: Array, dt_s: float, way_V: float) -> Array:
    out = np.empty(u.size)
    rate, rested = 0.0, 0.0
    out[0] = rate
    for k in range(1, u.size):
        rate, rested = rate_step(rate, rested, abs(u[k] - u[k - 1]), dt_s, way_V)
        out[k] = rate
    return out


def widening(context: Context, values: Values) -> tuple[Array, Array]:
    """Factor (1) and offset [V] of all thresholds above zero, each shape (N,)."""
    u = context.applied_V
    growth, kind = values["growth"], round(values.get("kind", LOGARITHM))
    decay = np.log1p(_rates(u, context.dt_s, values.get("rate_way_V", USUAL_WAY_V)) / values["reference_V_per_s"])
    if kind == OFFSET:
        return np.ones(u.size), OFFSET_SHARE * float(np.ptp(u)) * growth * decay
    factor: Array = np.exp(growth * decay) if kind == POWER else 1.0 + growth * decay
    return factor, np.zeros(u.size)


EFFECT = Effect(
    name="rate_dependent_hysteresis",
    title="hysteresis that grows with the rate",
    seat=Seat.HYSTERESIS,
    form="other",
    parameters=(
        Parameter("growth", "1", 0.0, 1.0, starts=(0.05,)),
        Parameter("reference_V_per_s", "V/s", 0.1, 1e4, starts=(3.0, 30.0, 300.0), logarithmic=True),
        Parameter("rate_way_V", "V", 0.01, 200.0, starts=(USUAL_WAY_V,), logarithmic=True, nuisance=True),
        Parameter("kind", "1", 0.0, 2.0, starts=(0.0,), nuisance=True, choices=(0.0, 1.0, 2.0)),
    ),
    forward=unchanged,
    widening=widening,
    handling="compensated",
    docstring=__doc__,
    separate_by="triangles of one amplitude over three decades of frequency, with a hold behind each corner",
)
