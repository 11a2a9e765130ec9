"""The preload is lost, and the first part of the force only closes a gap.

Forward    max(0, F - gap). For |F - gap| < softness: the parabola (F - gap + softness)^2 / (4 softness).
Inverse    F + gap for a force above zero. No smaller force is reachable, so the range begins at the contact.
Signature  No force and no slope at the bottom, then a kink. Look-alikes: output_nonlinearity has a slope at zero,
           voltage_clamp is flat at the top.
Location   Mechanics.
Valid      Records that reach the gap. softness is at most the gap, so that no force results from F = 0.
Source     K. L. Johnson (1985), Contact Mechanics, Cambridge University Press, unilateral contact. The parabola:
           derived here; piezod/effects/README.md, "Contact gap".
"""

import math

import numba
import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Checks, Context, Effect, Location, Values
from piezod.effects.parameter import Parameter, Search
from piezod.effects.tick import Memory, Tick, TickSetting


@numba.njit(cache=True, nogil=True)
def contact_step(force: float, gap: float, softness: float) -> float:
    """Force behind the gap [N]. A softness of 0 gives an abrupt kink.

    Parameters
    ----------
    force
        Force in front of the gap [N].
    gap
        Force that closes the gap [N], above 0.
    softness
        Half width of the rounded kink [N], at least 0; limited to `gap`.
    """
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
    """Force behind the gap, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    return _run(signal, values["gap_N"], values.get("softness_N", 0.0))


GAP_N, SOFT_N = range(2)  # memory


def _memory(values: Values, _setting: TickSetting) -> Array:
    return np.array([values["gap_N"], values.get("softness_N", 0.0)])


def _advance(own: Memory, _shared: Memory, force_N: float) -> float:
    return contact_step(force_N, own[GAP_N], own[SOFT_N])


def _invert(own: Memory, _shared: Memory, force_N: float) -> float:
    """Force in front of the gap; without force, the begin of contact."""
    soft = min(own[SOFT_N], own[GAP_N])
    if force_N <= 0.0:
        return own[GAP_N] - soft
    if force_N < soft:
        return own[GAP_N] + 2.0 * math.sqrt(force_N * soft) - soft
    return own[GAP_N] + force_N


PARTS = 0.01, 0.03, 0.08, 0.16, 0.32, 0.64  # of the force range: starts of the gap

EFFECT = Effect(
    name="contact_gap",
    title="gap before contact",
    location=Location.MECHANICS,
    form="memoryless",
    parameters=(
        Parameter(
            "gap_N",
            "N",
            1e-3,
            1e4,
            Search((2.0,), lambda driven: tuple(part * driven.force_span_N for part in PARTS), logarithmic=True),
            shown_by=lambda driven: (0.0, 0.9 * driven.force_span_N),
        ),
        Parameter(
            "softness_N",
            "N",
            0.0,
            100.0,
            Search((0.5,), lambda driven: (0.002 * driven.force_span_N,), nuisance=True),
        ),
    ),
    forward=forward,
    handling="compensated",
    tick=Tick(_memory, _advance, _invert),
    docstring=__doc__,
    separate_by="a slow ramp from zero voltage, and again with more preload",
    place=lambda values, _record: ("force_N", 0.0, values["gap_N"]),
    soft=True,
    checks=Checks(values={"gap_N": 20.0, "softness_N": 10.0}, constant="shifted"),
)
