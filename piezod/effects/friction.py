"""Presliding friction in the guide, which opposes every movement.

Forward    F - z, dz/dF = s / p (1 - sign(dF) z / force)^exponent (Dahl), exact over every stretch of one direction
Inverse    refused
Signature  loops whose width stops growing with the amplitude, at twice the force, and does not change with the rate;
           look-alike the plays themselves, which absorb it, and output_nonlinearity, which has one branch
Seat       mechanics
Valid      loops from below presliding_N to several times it; presliding_N is the travel, in force, in which 63 % arise
Source     THEORY 3 N (Dahl's equation); its closed forms derived here
"""

import math

import numba
import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values


@numba.njit(cache=True, nogil=True)
def _root(q: float, exponent: float) -> float:
    """What falls evenly with the travel while q = 1 - sign z falls by dq/d|travel| = -rate q^exponent."""
    if exponent == 1.0:
        return q
    return q ** (1.0 - exponent) if q > 0.0 or exponent < 1.0 else math.inf


@numba.njit(cache=True, nogil=True)
def _fallen(root: float, way: float, exponent: float, rate: float) -> float:
    """The same after a way in parts of `presliding_N`."""
    return root * math.exp(-way) if exponent == 1.0 else max(root + way * rate, 0.0)


@numba.njit(cache=True, nogil=True)
def _q(root: float, exponent: float) -> float:
    return min(root if exponent == 1.0 else root ** (1.0 / (1.0 - exponent)), 2.0)


@numba.njit(cache=True, nogil=True)
def dahl(force: Array, limit: float, presliding: float, exponent: float) -> Array:
    """Force less friction, shape (N,) [N], from friction 0; q falls from 1 to 1 / e within `presliding`."""
    out = np.empty(force.size)
    z, sign, root = 0.0, 0.0, 0.0
    rate = math.exp(exponent - 1.0) - 1.0
    out[0] = force[0]
    for k in range(1, force.size):
        travel = (force[k] - force[k - 1]) / presliding
        if travel != 0.0:
            turned = 1.0 if travel > 0.0 else -1.0
            if turned != sign:
                sign, root = turned, _root(min(max(1.0 - turned * z, 0.0), 2.0), exponent)
            root = _fallen(root, abs(travel), exponent, rate)
            z = sign * (1.0 - _q(root, exponent))
        out[k] = force[k] - limit * z
    return out


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Force that gets past the guide, shape (N,) [N]."""
    return dahl(signal, values["force_N"], values["presliding_N"], values.get("exponent", 1.0))


EFFECT = Effect(
    name="friction",
    title="friction in the guide",
    seat=Seat.MECHANICS,
    form="other",
    parameters=(
        Parameter("force_N", "N", 0.0, 1e3, starts=(1.0,)),
        Parameter("presliding_N", "N", 1e-2, 1e4, starts=(3.0, 20.0, 100.0), logarithmic=True),
        Parameter("exponent", "1", 0.05, 2.0, starts=(0.5,), nuisance=True),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why=(
        "it changes with preload, wear and the time at rest, and pushed the wrong way at a reversal it doubles the"
        " error; dither or a flexure instead of a guide removes it"
    ),
    separate_by="loop width against amplitude on logarithmic axes (friction 0 to 1, plays 2), and another preload",
)
