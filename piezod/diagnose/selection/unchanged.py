"""A check of the given model before a search: whether any change or further effect could be accepted.

Every candidate is estimated from one linear step at the given model: its parameters, the gain and loops of the stack,
and the effects and steps that the search would try. None of them is fitted. If no estimate comes near the least gain
that the search accepts, the search would find nothing, and is not begun.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.screening import Screening
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted
from piezod.diagnose.hypothesis.sampling import coarse
from piezod.diagnose.hypothesis.stack_change import GAIN, LOOPS
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.linear_gain import LinearGains, is_near
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.selection.tone_search import strongest_tone
from piezod.diagnose.selection.trials import suggested_steps


def is_unchanged(state: Search) -> bool:
    """Whether neither a change of the given model nor a further effect or tone could be accepted.

    A model that leaves more than noise is searched in any case: then pairs, corners and laws without a name count too.
    """
    fitted = state.hypothesis
    if fitted.loss > RULES.at_noise:
        return False
    few = coarse(state.chain)
    linear = LinearGains(few, fitted, state.least_gain)
    unchanged = (
        not any(linear.may_have_changed(name) for name in fitted.effects)
        and not linear.may_gain(
            *_with(fitted, (Term(GAIN, "since"), {"gain": 1.0}), (Term(LOOPS, "since"), {"loops": 1.0}))
        )
        and not _further_effect_gains(few, fitted, linear, state.least_gain)
        and strongest_tone(state) is None
    )
    few.forget()
    return unchanged


def _with(fitted: Fitted, *more: tuple[Term, Mapping[str, float]]) -> tuple[tuple[Term, ...], Point]:
    """Terms and point of a hypothesis with further terms at these values."""
    terms, values = zip(*more, strict=True)
    return (*fitted.terms, *terms), replace(fitted.point, values=(*fitted.point.values, *values))


def _further_effect_gains(few: Chain, fitted: Fitted, linear: LinearGains, least: float) -> bool:
    """Whether an effect that the hypothesis lacks, or a step of the load, comes near the least gain."""
    screening = Screening(few, fitted.terms, fitted.point)
    steadiest = float(np.sqrt(np.count_nonzero(fitted.samples)))  # of a gain that is equal in all blocks
    if screening.singles and is_near(screening.loss, screening.singles[0].loss, steadiest, least):
        return True
    steps = suggested_steps(few, fitted)
    return any(linear.may_gain(*_with(fitted, (step.term, step.values))) for step in steps)
