"""The preload is lost: the first part of the force only closes a gap.

Forward    max(0, F - gap); within softness of touching the parabola (F - gap + softness)^2 / (4 softness)
Inverse    F + gap above zero; below, no force can be asked for: the reachable range begins at touching
Signature  no force and no slope at the bottom, then a kink; look-alikes output_nonlinearity (has a slope at zero),
           voltage_clamp (flat at the top)
Seat       mechanics
Valid      records that come down to the gap; softness is at most the gap, so nothing arrives from F = 0
Source     K. L. Johnson (1985), Contact Mechanics, unilateral contact; the parabola derived here;
           piezod/effects/README.md, "Contact gap"
"""

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def contact_step(force: float, gap: float, softness: float) -> float:
    """Force that arrives behind the gap; softness 0 is a sharp kink [N]."""
    beyond = force - gap
    soft = min(softness, gap)
    if abs(beyond) < soft:
        return (beyond + soft) ** 2 / (4.0 * soft)
    return max(beyond, 0.0)


@numba.njit(cache=True, nogil=True)
def _run(force: Array, gap: float, softness: float) -> Array:
    out = np.empty(force.size)
    for k in range(force.size):
        out[k] = contact_step(force[k], gap, softness)
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Force that arrives behind the gap, shape (N,) [N]."""
    return _run(signal, values["gap_N"], values.get("softness_N", 0.0))


EFFECT = Effect(
    name="contact_gap",
    title="gap before contact",
    seat=Seat.MECHANICS,
    form="memoryless",
    parameters=(
        Parameter("gap_N", "N", 1e-3, 1e4, starts=(2.0, 20.0, 100.0), logarithmic=True),
        Parameter("softness_N", "N", 0.0, 100.0, starts=(0.5,), nuisance=True),
    ),
    forward=forward,
    handling="compensated",
    docstring=__doc__,
    separate_by="a slow ramp from zero voltage, and again with more preload",
)
