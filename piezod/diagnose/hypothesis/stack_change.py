"""A change of the stack itself since the identification: its gain, and the width of its loops.

Both act in the recordings to explain only. They are not in the catalogue: the written model has them in its base, and
a diagnosis reports them as a change of the base. The gain scales the stroke, as of a stack that lost polarisation, or
the force, as of another load cell. With a straight force law both are equal.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from piezod.arrays import Array
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.sampling import fit_from_each, with_usual_start
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects.effect import Context, Effect, Location, Values, unchanged
from piezod.effects.parameter import Parameter, Search

STROKE, FORCE = 0.0, 1.0  # what the gain scales
CLEARLY = 0.9  # loss of a gain of the force over that of a gain of the stroke, below which the force is scaled


def _scaled(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """The stroke [V] or the force [N] times the gain, shape (N,)."""
    return signal * values["gain"]


GAIN = Effect(
    name="gain",
    title="gain of the stack",
    location=Location.STACK,
    form="scaling",
    parameters=(
        Parameter("gain", "1", 0.1, 10.0, Search((1.0,), logarithmic=True)),
        Parameter("of", "1", STROKE, FORCE, Search((STROKE,), nuisance=True, choices=(STROKE, FORCE))),
    ),
    forward=_scaled,
    behind_law=("of", FORCE),
    handling="compensated",
    docstring=__doc__,
)
LOOPS = Effect(
    name="loops",
    title="loops of the stack",
    location=Location.HYSTERESIS,
    form="other",
    parameters=(Parameter("loops", "1", 0.1, 10.0, Search((1.0,), logarithmic=True)),),
    forward=unchanged,
    handling="compensated",
    docstring=__doc__,
)
NAMES = (GAIN.name, LOOPS.name)


class StackFactors(NamedTuple):
    """Factors since the identification [1]."""

    stroke: float = 1.0
    loops: float = 1.0
    force: float = 1.0


def with_stack_changed(chain: Chain, fitted: Fitted, past: Point) -> tuple[Chain, Fitted]:
    """Hypothesis with a change of gain and of loop width since the identification.

    The fit begins at the hypothesis, and at the base of the identification alone, because a change bends the base. It
    bends the estimated start of a recording too, so the usual starts are compared again.
    """
    chain, of_stroke = with_usual_start(chain, _with_gain_of(STROKE, chain, fitted, past))
    of_force = _with_gain_of(FORCE, chain, fitted, past)
    return chain, of_force if of_force.loss < CLEARLY * of_stroke.loss else of_stroke


def _with_gain_of(what: float, chain: Chain, fitted: Fitted, past: Point) -> Fitted:
    gain = Term(GAIN, "since", choices=(("of", what),))
    values = (*fitted.point.values, {"gain": 1.0}, {"loops": 1.0})
    starts = [replace(fitted.point, values=values)]
    if past.alike(fitted.point):
        starts.append(replace(past, values=values))
    return fit_from_each(chain, (*fitted.terms, gain, Term(LOOPS, "since")), starts)


def factors(terms: Sequence[Term], point: Point) -> StackFactors:
    """Factors of a hypothesis."""
    now = StackFactors()
    for term, values in zip(terms, point.values, strict=True):
        if term.effect.name == LOOPS.name:
            now = now._replace(loops=values["loops"])
        elif term.effect.name == GAIN.name and GAIN.behind_law in term.choices:
            now = now._replace(force=values["gain"])
        elif term.effect.name == GAIN.name:
            now = now._replace(stroke=values["gain"])
    return now
