"""The amplifier's output stage saturates: above its limit the voltage stays where it is.

Forward    u' = min(u, limit); within knee of it the parabola u - (u - limit + knee)^2 / (4 knee) joins both lines
Inverse    none above the limit: the reachable force is reported, and the states advance with u'
Signature  flat tops at one voltage and at any rate; look-alikes output_nonlinearity (still rises there),
           slew_limit (needs a rate)
Seat       amplifier, in front of the hysteresis
Valid      limits inside the range that was driven; one that is never reached cannot be seen
Source     derived here, the parabola too; piezod/effects/README.md, "Voltage clamp"
"""

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def clamp_step(u: float, limit: float, knee: float) -> float:
    """Voltage that the output stage can give where `u` is asked for; the knee may be 0 [V]."""
    if abs(u - limit) < knee:
        return u - (u - limit + knee) ** 2 / (4.0 * knee)
    return min(u, limit)


@numba.njit(cache=True, nogil=True)
def _run(u: Array, limit: float, knee: float) -> Array:
    out = np.empty(u.size)
    for k in range(u.size):
        out[k] = clamp_step(u[k], limit, knee)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Voltage that the output stage can give, shape (N,) [V]."""
    return _run(signal, values["limit_V"], values.get("knee_V", 0.0))


EFFECT = Effect(
    name="voltage_clamp",
    title="saturation of the amplifier",
    seat=Seat.AMPLIFIER,
    form="memoryless",
    parameters=(
        Parameter("limit_V", "V", 0.5, 2000.0, starts=(30.0, 60.0, 95.0, 130.0), logarithmic=True),
        Parameter("knee_V", "V", 1e-3, 20.0, starts=(0.3,), logarithmic=True, nuisance=True),
    ),
    forward=forward,
    handling="compensated",
    docstring=__doc__,
    separate_by="two slow triangles with tops below and above the limit, the amplifier's monitor output beside them",
)
