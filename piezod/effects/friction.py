"""The guide of the load resists every movement, and deforms before it slides (presliding).

Forward    F - force z, with z the state of `bouc_wen` moved by F. Exponent 1 and closing 1 is Dahl's solid friction.
           Closing 0.5 and a large exponent is a spring that yields at its limit and then slides. A load cell behind
           the guide lacks the friction. One in front of it measures the friction too: force_N is below 0.
Inverse    Refused.
Signature  Loops whose width stops at twice the friction force and does not depend on the rate. Look-alikes: the plays,
           which absorb it, and output_nonlinearity, which has one branch.
Location   Mechanics.
Valid      Loops from below presliding_N to several times it. presliding_N is the movement, measured in force, in which
           z rises from 0 to 63 %.
Source     P. R. Dahl (1968), A Solid Friction Model, DTIC ADA041920. M. Ismail, F. Ikhouane and J. Rodellar (2009), The
           Hysteresis Bouc-Wen Model, a Survey, doi:10.1007/s11831-009-9031-8. piezod/effects/README.md, "Friction".
"""

import numpy as np

from piezod.arrays import Array
from piezod.effects.effect import Context, Effect, Location, Values
from piezod.effects.kernels import bouc_wen
from piezod.effects.parameter import Parameter, Search

NO_PATH = np.empty(0)


SLIDES = 0.16  # of the range of the force: friction with a longer presliding hardly slides, the stack remembers


def forward(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """Force behind the guide, shape (N,) [N].

    `signal` is the force [N]. Parameters as in `piezod.effects.effect.Forward`.
    """
    state = bouc_wen(NO_PATH, signal, values["presliding_N"], values.get("exponent", 1.0), values.get("closing", 1.0))
    result: Array = signal - values["force_N"] * state
    return result


PARTS = 0.01, 0.04, 0.12  # of the force range: starts of the presliding force

EFFECT = Effect(
    name="friction",
    title="friction in the guide",
    location=Location.MECHANICS,
    form="other",
    parameters=(
        Parameter("force_N", "N", -1e3, 1e3, Search((1.0,), lambda driven: (0.005 * driven.force_span_N,))),
        Parameter(
            "presliding_N",
            "N",
            1e-2,
            1e4,
            Search((3.0,), lambda driven: tuple(part * driven.force_span_N for part in PARTS), logarithmic=True),
            shown_by=lambda driven: (1e-3 * driven.force_span_N, driven.force_span_N),
        ),
        Parameter("exponent", "1", 0.5, 8.0, Search((1.5,), logarithmic=True, nuisance=True)),
        Parameter("closing", "1", 0.3, 1.0, Search((0.7,), logarithmic=True, nuisance=True)),
    ),
    forward=forward,
    handling="refused",
    docstring=__doc__,
    why=(
        "it changes with preload, wear and the time at rest; a correction with the wrong sign at a reversal doubles the"
        " error; dither, or a flexure instead of a guide, removes it"
    ),
    separate_by="loop width against amplitude on logarithmic axes (friction 0 to 1, plays 2), and another preload",
    plausible=lambda values, record: values["presliding_N"] <= SLIDES * record.highest["presliding_N"],
    flexible=True,
)
