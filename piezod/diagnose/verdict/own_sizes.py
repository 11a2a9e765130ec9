"""Sizes of the given effects, and gain and loops of the stack, by the diagnosed recordings alone.

A model keeps its values until a recording excludes them, so a slow change is seen in no single recording. These
estimates follow it: a history compares them over time. Each comes from one linear step at the final hypothesis. The
base is as well known as by the given model; the other parameters of each effect stay.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from piezod.diagnose.findings import Value
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal
from piezod.diagnose.hypothesis.layout import scaled, unscaled
from piezod.diagnose.hypothesis.left_out import covariance, form_error
from piezod.diagnose.hypothesis.stack_change import GAIN, LOOPS
from piezod.diagnose.hypothesis.terms import Term
from piezod.model import Model
from piezod.model.base_figures import base_figures

HALF_95 = 1.96  # half of a 95 % interval [standard errors]


def own_sizes(chain: Chain, fitted: Fitted, given: Collection[str]) -> dict[str, Value]:
    """Size of each given effect, and the factors `gain` and `loops` of the stack, by name, with 95 % intervals.

    A size whose linear step leaves the range of the parameter is omitted.

    Parameters
    ----------
    chain
        Recordings; the identification or its substitute counts fully.
    fitted
        Final hypothesis.
    given
        Names of the effects of the given model.
    """
    terms = [replace(term, held=term.effect.name not in (*given, GAIN.name, LOOPS.name)) for term in fitted.terms]
    values = list(fitted.point.values)
    for effect in (GAIN, LOOPS):
        if effect.name not in fitted.effects:
            terms.append(Term(effect, "since"))
            values.append({effect.name: 1.0})
    normal = Normal.at(chain, terms, replace(fitted.point, values=tuple(values)))
    searched = list(enumerate(normal.layout.searched, start=normal.layout.effects))
    sizes = [
        (place, term, parameter)
        for place, (term, parameter) in searched
        if parameter.name == terms[term].effect.size.name
    ]
    held = np.full(normal.layout.size, np.nan)
    held[normal.layout.effects :] = 0.0
    places = [place for place, _, _ in sizes]
    held[places] = np.nan
    step, moves = normal.step(0.0, held), normal.left_out_moves(held)[:, places]
    now = [scaled(parameter, values[term][parameter.name]) for _, term, parameter in sizes]
    form = np.array([form_error(parameter, values[term][parameter.name]) for _, term, parameter in sizes])
    half = HALF_95 * np.sqrt(np.diag(covariance(moves, form)))
    own = {}
    for (place, term, parameter), x, width in zip(sizes, now, half.tolist(), strict=True):
        ends = (x + float(step[place]) + away for away in (0.0, -width, width))
        value, low, high = (unscaled(parameter, end) for end in ends)
        if parameter.low < value < parameter.high:
            own[terms[term].effect.name] = Value(value, parameter.unit, low, high)
    return own


def own_base(model: Model, own: Mapping[str, Value]) -> dict[str, Value]:
    """Gain and loop width of the stack, as in `BaseFigures`, from the factors that `own_sizes` returns."""
    figures = base_figures(model.hysteresis, model.input.low, model.input.high)
    gain_unit = f"{model.output.unit}/{model.input.unit}"
    known = {"gain": (GAIN, figures.gain, gain_unit), "loop_width_percent": (LOOPS, figures.loop_width_percent, "%")}
    return {
        name: _times(own[factor.name], figure, unit)
        for name, (factor, figure, unit) in known.items()
        if factor.name in own
    }


def _times(factor: Value, known: float, unit: str) -> Value:
    return Value(known * factor.value, unit, known * factor.low, known * factor.high)
