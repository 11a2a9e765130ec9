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
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.sampling import best_coarsely, coarse, with_usual_start
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects.effect import Context, Effect, Location, Values, unchanged
from piezod.effects.parameter import Parameter, Search

STROKE, FORCE = KINDS = 0.0, 1.0  # what the gain scales
CLEARLY = 0.9  # loss of a gain of the force over that of a gain of the stroke, below which the force is scaled
ROUGHLY = 0.5  # share of a required gain that a coarse fit must reach: its few steps leave some of it


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


def with_stack_changed(chain: Chain, fitted: Fitted, past: Point, limit: float) -> tuple[Chain, Fitted] | None:
    """Hypothesis with a change of gain and of loop width since the identification.

    The fit begins at the hypothesis, and at the base of the identification alone, because a change bends the base. It
    bends the estimated start of a recording too, so the usual starts are compared again.

    Parameters
    ----------
    chain, fitted, past
        Recordings, hypothesis so far, and base of the identification.
    limit
        Loss from which a change is of no use; None is returned where few samples show that it stays far above.
    """
    values = (*fitted.point.values, {"gain": 1.0}, {"loops": 1.0})
    starts = [replace(fitted.point, values=values)]
    if past.alike(fitted.point):
        starts.append(replace(past, values=values))
    gains = {what: Term(GAIN, "since", choices=(("of", what),)) for what in KINDS}
    terms = {what: (*fitted.terms, gain, Term(LOOPS, "since")) for what, gain in gains.items()}
    few = coarse(chain)
    known = fit(few, fitted.terms, fitted.point, most_steps=2)
    best = {what: best_coarsely(few, terms[what], starts) for what in KINDS}
    few.forget()
    gain = 1.0 - min(one.loss for one in best.values()) / known.loss
    if gain < ROUGHLY * (1.0 - limit / fitted.loss):
        return None
    chain, of_stroke = with_usual_start(chain, fit(chain, terms[STROKE], best[STROKE].point))
    of_force = fit(chain, terms[FORCE], best[FORCE].point)
    return chain, of_force if of_force.loss < CLEARLY * of_stroke.loss else of_stroke


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
