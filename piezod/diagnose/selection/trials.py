"""One more effect: every one that promises something fitted, coarsely first, the best of them thoroughly."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.screening import Idea, screened, screened_pairs, since
from piezod.diagnose.candidates.steps import NEVER_S, edge_near, likely_steps, sharpest_steps, shown_late_s
from piezod.diagnose.hypothesis.chain import Chain, Point, Scope, Term
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, Normal, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import coarse, started_alike
from piezod.effects import EFFECTS
from piezod.recording.hold import STRAIGHT

Array = NDArray[np.float64]

TRIED = 7  # effects that are really fitted in a round, first coarsely
TRIED_FROM_PAST = 3
REFINED = 4  # of them thoroughly
COMPARED = 6  # of all these on more samples
PAIRS = 4  # of effects that are fitted at once
LATE_BY = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # samples, behind which a coupling of the drive is looked for
NEAR = 0.4  # of the best one's gain, from which one is fitted thoroughly, or on more samples
FEWEST_REFINED, FEWEST_COMPARED = 2, 3
COARSE_STEPS = 7
RACED_STEPS = 2  # after which those that are ahead go on
NOTHING = 0.01  # of the loss: an idea that promises less to first order is not tried
PROMISING = 0.03  # of the best idea's gain, below which an idea is not tried


def on_each_course(chain: Chain, found: Fitted, past: Point) -> list[tuple[Chain, Fitted]]:
    """Hypotheses with one more effect, with the chain that each was fitted on.

    Where the command seems to be held although nothing smooths it, an effect that makes late may have passed for that:
    all is tried with a straight course too. Where a recording seems to start unlike those of the identification,
    an effect that came since may have passed for that.
    """
    chains = [(chain, found)]
    if not chain.series[0].hold.straight and not any(term.effect.smooths for term in found.terms):
        straight = chain.like([replace(one, hold=STRAIGHT) for one in chain.series])
        chains.append((straight, fit(straight, found.terms, found.point, most_steps=6)))
    found_on = []
    for on, known in chains:
        few = coarse(on)
        tried = _tried(few, known, past)
        few.forget()
        found_on += [(on, one) for one in _fine(on, known, tried)]
    alike = started_alike(chain)
    if alike is not None:
        few = coarse(alike)
        quick = _since_past(few, found, past)
        few.forget()
        found_on += [(alike, one) for one in _fine(alike, found, quick)]
    return found_on


def with_a_step(chain: Chain, found: Fitted, others: Sequence[Fitted]) -> list[tuple[Chain, Fitted]]:
    """Hypotheses that a step of the load was preferred to, each with a step of its own: the pair may need another one.

    A step that stays passes for a drift and a step that goes again, and beside it nobody sees the drift.
    """
    few = coarse(chain)
    starts = [(other, idea) for other in others for idea in suggested(few, other)]
    tried = each(lambda one: _extended(few, *one), starts)
    few.forget()
    return [(chain, one) for one in _fine(chain, found, tried)]


def two_at_once(chain: Chain, found: Fitted) -> list[Fitted]:
    """Hypotheses with two more effects, of the pairs that promise most; one of both has a shape of its own."""
    few = coarse(chain)
    promising = screened_pairs(few, found.terms, found.point)
    enough = _enough(few, found)
    shaped = [pair for pair in promising if pair[0].gain > enough and any(_has_a_shape(idea) for idea in pair)]

    def fitted(pair: tuple[Idea, Idea]) -> Fitted:
        return fit(few, *_with(found, pair))

    tried = sorted(each(fitted, shaped[:PAIRS]) + _coupled_late(few, found), key=lambda one: one.loss)
    for place in (len(found.terms), len(found.terms) + 1):
        tried = each(partial(_varied, few, place=place), tried[:FEWEST_REFINED])
    few.forget()
    return _fine(chain, found, tried)


def _has_a_shape(idea: Idea) -> bool:
    """Whether an effect bends to few things; one that is soft bends to whatever is left at low force."""
    effect = idea.term.effect
    return not effect.flexible and not effect.soft


def _coupled_late(chain: Chain, found: Fitted) -> list[Fitted]:
    """The drive's coupling behind a delay: its jumps are a sample wide, and only their own place shows them."""
    names = "transport_delay", "feedthrough"
    if any(name in found.effects for name in names):
        return []
    dt_s = min(one.dt_s for one in chain.series)
    scopes: tuple[Scope, ...] = ("since", "already")
    starts = [
        (_idea(names[0], -1, {"delay_s": late * dt_s}, scope), _idea(names[1], -1, {}, other))
        for late in LATE_BY
        for scope in scopes
        for other in scopes
    ]
    first = each(lambda pair: fit(chain, *_with(found, pair), most_steps=RACED_STEPS), starts)
    ahead = sorted(first, key=lambda one: one.loss)[:PAIRS]
    tried = each(lambda one: fit(chain, one.terms, one.point, most_steps=COARSE_STEPS), ahead)
    return sorted(tried, key=lambda one: one.loss)[:FEWEST_REFINED]


def _with(found: Fitted, ideas: Sequence[Idea]) -> tuple[tuple[Term, ...], Point]:
    """A hypothesis with more effects, and where it begins."""
    terms = (*found.terms, *(idea.term for idea in ideas))
    return terms, replace(found.point, values=(*found.point.values, *(idea.values for idea in ideas)))


def _enough(chain: Chain, found: Fitted) -> float:
    """What an idea must promise to be tried, as its gain."""
    samples = sum(float(one.counts[rows].sum()) for one, rows in zip(chain.series, chain.rows, strict=True))
    return NOTHING * found.loss * samples


def _fine(chain: Chain, before: Fitted, tried: Sequence[Fitted]) -> list[Fitted]:
    """The best of what was fitted on few samples, fitted on more."""
    best = sorted(tried, key=lambda one: one.loss)
    enough = before.loss - NEAR * (before.loss - best[0].loss) if best else 0.0
    near = sum(one.loss < enough for one in best[:COMPARED])
    starts = [(one.terms, _at_edges(chain, one)) for one in best[: max(near, FEWEST_COMPARED)]]
    return each(lambda one: fit(chain, *one, most_steps=6), starts)


def _at_edges(chain: Chain, fitted: Fitted) -> Point:
    """A step of the load that was fitted on few samples, moved to where the readings jump."""
    term, values = fitted.terms[-1], fitted.point.values[-1]
    if term.effect.name != "load_step":
        return fitted.point
    series = chain.series[term.series]
    without = replace(fitted.point, values=(*fitted.point.values[:-1], {**values, "step_N": 0.0}))
    left_N = series.reading_N - chain.run(term.series, fitted.terms, without).reading_N
    late_s = shown_late_s(chain, fitted.terms, fitted.point)
    inside = {name: values[name] for name in ("on_s", "off_s") if 0.0 < values[name] < series.duration_s}
    moved = {name: edge_near(series, left_N, at_s + late_s) - late_s for name, at_s in inside.items()}
    return replace(fitted.point, values=(*fitted.point.values[:-1], {**values, **moved}))


def _tried(chain: Chain, found: Fitted, past: Point) -> list[Fitted]:
    """Hypotheses with one more effect: all promising ones fitted in few steps, the best of them thoroughly.

    From what was found so far, and those that came since from their best start from the `past` too: a strong effect
    bends the base towards itself.
    """
    ideas = screened(chain, found.terms, found.point)
    enough = _enough(chain, found)
    chosen: dict[str, list[Idea]] = {}
    for idea in ideas:
        if idea.gain < max(PROMISING * ideas[0].gain, enough):
            break
        if len(chosen) < TRIED or idea.term.effect.name in chosen:
            chosen.setdefault(idea.term.effect.name, []).append(idea)
    quick = each(lambda some: (_extended(chain, found, some[0], most_steps=COARSE_STEPS), some), list(chosen.values()))
    quick += [(one, []) for one in _since_past(chain, found, past)]
    quick.sort(key=lambda one: one[0].loss)
    quick = [one for k, one in enumerate(quick) if one[0].effects[-1] not in (o[0].effects[-1] for o in quick[:k])]
    enough = found.loss - NEAR * (found.loss - quick[0][0].loss) if quick else 0.0
    near = sum(one.loss < enough for one, _ in quick[:REFINED])
    refined = max(near, FEWEST_REFINED)
    thorough = each(lambda one: _refined(chain, found, *one), quick[:refined])
    direct = each(lambda idea: _extended(chain, found, idea), suggested(chain, found))
    return [*thorough, *(first for first, _ in quick[refined:]), *direct]


def _since_past(chain: Chain, found: Fitted, past: Point) -> list[Fitted]:
    """Hypotheses with one more effect that came since, fitted from the base as it was."""
    bases = [replace(past, values=found.point.values), *([found.point] if found.terms else [])]
    lost_N = -min(found.point.offsets_N[k] for k, one in enumerate(chain.series) if one.role == "recording")
    starts = [one for base in bases for one in since(chain, found.terms, base, lost_N)[:TRIED_FROM_PAST]]
    return each(partial(_from_past, chain, found.terms), starts)


def _from_past(chain: Chain, terms: tuple[Term, ...], one: tuple[Idea, Point]) -> Fitted:
    idea, past = one
    point = replace(past, values=(*past.values, idea.values))
    return fit(chain, (*terms, idea.term), point, most_steps=COARSE_STEPS)


def _refined(chain: Chain, found: Fitted, first: Fitted, ideas: Sequence[Idea]) -> Fitted:
    """The best fit of one effect: from its second start too, in both scopes, with every choice."""
    best = fit(chain, first.terms, first.point)
    others = [idea for idea in ideas[1:] if _other_start(idea, ideas[0]) and idea.gain > 0.3 * ideas[0].gain]
    for idea in others[:2]:
        best = min(best, _extended(chain, found, idea), key=lambda one: one.loss)
    return _varied(chain, best, len(best.terms) - 1)


def _other_start(one: Idea, other: Idea) -> bool:
    return (one.values, one.term.choices) != (other.values, other.term.choices)


def _varied(chain: Chain, best: Fitted, place: int) -> Fitted:
    """The best fit with the other scope or another choice of an effect."""
    scopes: tuple[Scope, ...] = ("since", "already")
    for scope in scopes:
        if scope != best.terms[place].scope:
            best = min(best, _again(chain, best, place, scope=scope), key=lambda one: one.loss)
    for parameter in best.terms[place].effect.parameters:
        for choice in parameter.search.choices:
            if (parameter.name, choice) not in best.terms[place].choices:
                other = _again(chain, best, place, choice=(parameter.name, choice))
                best = min(best, other, key=lambda one: one.loss)
    return best


def _extended(chain: Chain, found: Fitted, idea: Idea, most_steps: int = MOST_STEPS) -> Fitted:
    return fit(chain, *_with(found, (idea,)), most_steps=most_steps)


def _again(
    chain: Chain, fitted: Fitted, place: int, *, scope: Scope | None = None, choice: tuple[str, float] | None = None
) -> Fitted:
    """The same hypothesis with another scope or choice of an effect."""
    other = fitted.terms[place]
    if scope is not None:
        other = replace(other, scope=scope)
    if choice is not None:
        other = replace(other, choices=tuple(choice if one[0] == choice[0] else one for one in other.choices))
    return fit(chain, (*fitted.terms[:place], other, *fitted.terms[place + 1 :]), fitted.point, most_steps=6)


def suggested(chain: Chain, found: Fitted) -> list[Idea]:
    """Steps of the load that the residuals suggest."""
    if "load_step" in found.effects:
        return []
    normal = Normal.at(chain, found.terms, found.point)
    modelled = normal.readings()
    ideas = []
    for number, series in enumerate(chain.series):
        if series.role == "identification":
            continue
        left_N = series.reading_N - modelled[number]
        for step in (*likely_steps(normal, number), *sharpest_steps(series, left_N)):
            end_s = NEVER_S if step.end == series.time_s.size else step.end * series.dt_s
            places = {"step_N": step.height_N, "on_s": step.first * series.dt_s, "off_s": end_s}
            shown = _idea("load_step", number, places)
            beside = replace(found.point, values=(*found.point.values, shown.values))
            late_s = shown_late_s(chain, (*found.terms, shown.term), beside)
            places |= {name: places[name] - late_s for name in ("on_s", "off_s")}
            ideas.append(_idea("load_step", number, places))
    return ideas


def _idea(name: str, number: int, known: dict[str, float], scope: Scope = "once") -> Idea:
    effect = EFFECTS[name]
    values = {one.name: one.search.starts[0] for one in effect.parameters if not one.search.choices}
    choices = tuple((one.name, one.search.choices[0]) for one in effect.parameters if one.search.choices)
    values.update(
        {
            key: float(np.clip(value, effect.parameter(key).low, effect.parameter(key).high))
            for key, value in known.items()
        }
    )
    return Idea(Term(effect, scope, number, choices), values)
