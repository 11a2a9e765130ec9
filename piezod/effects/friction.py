"""Presliding friction in the guide, which opposes every movement.

Forward    F - force z, z the state of `bouc_wen` moved by F: from Dahl's solid friction (exponent 1, closing 1) to a
           spring that yields up to its limit and then slides (closing 0.5, a large exponent)
Inverse    refused
Signature  loops whose width stops growing with the amplitude, at twice the force, and does not change with the rate;
           look-alike the plays themselves, which absorb it, and output_nonlinearity, which has one branch
Seat       mechanics
Valid      loops from below presliding_N to several times it; presliding_N is the travel, in force, in which 63 % arise
Source     P. R. Dahl (1968), A Solid Friction Model, DTIC ADA041920; Ismail, Ikhouane and Rodellar (2009), The
           Hysteresis Bouc-Wen Model, a Survey, doi:10.1007/s11831-009-9031-8; piezod/effects/README.md, "Friction"
"""

import numpy as np

from piezod.effects.effect import Array, Context, Effect, Parameter, Seat, Values
from piezod.effects.kernels import bouc_wen

NOTHING_BEFORE = np.empty(0)


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Force that gets past the guide, shape (N,) [N]."""
    state = bouc_wen(
        NOTHING_BEFORE, signal, values["presliding_N"], values.get("exponent", 1.0), values.get("closing", 1.0)
    )
    result: Array = signal - values["force_N"] * state
    return result


EFFECT = Effect(
    name="friction",
    title="friction in the guide",
    seat=Seat.MECHANICS,
    form="other",
    parameters=(
        Parameter("force_N", "N", 0.0, 1e3, starts=(1.0,)),
        Parameter("presliding_N", "N", 1e-2, 1e4, starts=(3.0, 20.0, 100.0), logarithmic=True),
        Parameter("exponent", "1", 0.5, 8.0, starts=(1.5,), logarithmic=True, nuisance=True),
        Parameter("closing", "1", 0.3, 1.0, starts=(0.7,), logarithmic=True, nuisance=True),
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
