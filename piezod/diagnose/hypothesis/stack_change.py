"""A change of the stack itself since the identification: its gain, and the width of its loops.

Both act in the recordings asked about only. They are no effects of the catalogue: the written model has them in its
base, and a diagnosis reports them as a change of the base.
"""

from collections.abc import Sequence
from dataclasses import replace

from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.effects.effect import Array, Context, Effect, Location, Parameter, Search, Values, unchanged


def _scaled(signal: Array, context: Context, values: Values) -> Array:  # noqa: ARG001  # a `Forward`
    """The stroke times the gain, shape (N,) [V]."""
    return signal * values["gain"]


GAIN = Effect(
    name="gain",
    title="gain of the stack",
    location=Location.STACK,
    form="scaling",
    parameters=(Parameter("gain", "1", 0.1, 10.0, Search((1.0,), logarithmic=True)),),
    forward=_scaled,
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


def with_stack_changed(chain: Chain, found: Fitted, past: Point) -> Fitted:
    """The hypothesis with another gain and wider or narrower loops since the identification.

    It is fitted from where it stands, and from the base as the identification alone shows it: a change bends the base.
    """
    terms = (*found.terms, Term(GAIN, "since"), Term(LOOPS, "since"))
    values = (*found.point.values, {"gain": 1.0}, {"loops": 1.0})
    starts = [replace(found.point, values=values)]
    if past.alike(found.point):
        starts.append(replace(past, values=values))
    return min((fit(chain, terms, start) for start in starts), key=lambda one: one.loss)


def factors(found: Fitted) -> tuple[float, float]:
    """Gain and width of the loops, in parts of those at the identification; 1 where they have not changed [1]."""
    known = {name: values[name] for term, values in _pairs(found) for name in NAMES if term.effect.name == name}
    return known.get("gain", 1.0), known.get("loops", 1.0)


def _pairs(found: Fitted) -> Sequence[tuple[Term, Values]]:
    return list(zip(found.terms, found.point.values, strict=True))
