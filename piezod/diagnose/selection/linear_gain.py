"""Gains of changes of a hypothesis, estimated by one linear step each, without a fit."""

from collections.abc import Sequence
from dataclasses import replace

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import comparable, least_gain, steadiness

NEAR = 0.5
"""Share of the least accepted gain that an estimate must stay below: a fit gains more than a linear step from it."""


class LinearGains:
    """Estimates at a fitted hypothesis.

    Parameters
    ----------
    few
        Chain with few compared samples.
    fitted
        Hypothesis; the effects of the given model that have not changed are held in it.
    least
        Least gain that the search accepts in any case [noise variance].
    """

    def __init__(self, few: Chain, fitted: Fitted, least: float = 0.0) -> None:
        self._few, self._fitted, self._least = few, fitted, least
        self._normal = Normal.at(few, fitted.terms, fitted.point, robust=False)
        self._before = self._normal.fitted()

    def may_gain(self, terms: Sequence[Term], point: Point) -> bool:
        """Whether a linear step with other terms comes near the least gain over the hypothesis."""
        there = Normal.at(self._few, terms, point, robust=False).fitted()
        before, after = comparable(self._before, there)
        return is_near(before.loss, after.loss, steadiness(before, after), self._least)

    def may_have_changed(self, name: str) -> bool:
        """Whether other parameters of a held effect come near the least gain."""
        fitted = self._fitted
        terms = [replace(term, held=False) if term.effect.name == name else term for term in fitted.terms]
        return self.may_gain(terms, fitted.point)

    def clearly_seen(self, name: str) -> bool:
        """Whether the loss without an effect is higher by more than any gain that the search demands.

        The parameters of the base follow the missing effect by a linear step.
        """
        fitted, normal = self._fitted, self._normal
        others = [k for k, term in enumerate(fitted.terms) if term.effect.name != name]
        terms = [fitted.terms[k] for k in others]
        point = replace(fitted.point, values=tuple(fitted.point.values[k] for k in others))
        compared = enumerate(normal.compared)
        changes = [(self._few.compared(k, terms, point) - compared_N)[:, None] for k, compared_N in compared]
        energy = float(normal.projected(changes)[0][0, 0])
        return energy / float(normal.blocks.samples.sum()) > RULES.worth / NEAR * fitted.loss


def is_near(before: float, after: float, steady: float, least: float = 0.0) -> bool:
    """Whether a gain is at least `NEAR` of the least accepted gain with this steadiness, and of `least`."""
    return before - after > NEAR * max(least_gain(steady) * after, least)
