"""A change of the stack itself since the identification: its gain, and the width of its loops.

Both act in the recordings to explain only. They are not in the catalogue: the written model has them in its base, and
a diagnosis reports them as a change of the base.
"""

from dataclasses import replace

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.sampling import fit_from_each
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.effects.effect import Array, Context, Effect, Location, Values, unchanged
from piezod.effects.parameter import Parameter, Search


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


def with_stack_changed(chain: Chain, fitted: Fitted, past: Point) -> Fitted:
    """Hypothesis with a change of gain and of loop width since the identification.

    The fit begins at the hypothesis, and at the base of the identification alone, because a change bends the base.
    """
    terms = (*fitted.terms, Term(GAIN, "since"), Term(LOOPS, "since"))
    values = (*fitted.point.values, {"gain": 1.0}, {"loops": 1.0})
    starts = [replace(fitted.point, values=values)]
    if past.alike(fitted.point):
        starts.append(replace(past, values=values))
    return fit_from_each(chain, terms, starts)


def factors(fitted: Fitted) -> tuple[float, float]:
    """Gain and loop width relative to the identification [1]."""
    pairs = zip(fitted.terms, fitted.point.values, strict=True)
    known = {name: values[name] for term, values in pairs for name in NAMES if term.effect.name == name}
    return known.get("gain", 1.0), known.get("loops", 1.0)
