"""Trials of one more effect: all promising ones are fitted coarsely, and the best of them thoroughly."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.screening import (
    Candidate,
    screened,
    screened_pairs,
    since_identification,
    within_ranges,
)
from piezod.diagnose.candidates.steps import NEVER_S, edge_near, jump_steps, likely_steps, shown_late_s
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, Normal, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import coarse, with_equal_starts
from piezod.diagnose.hypothesis.terms import Point, Scope, Term
from piezod.effects import EFFECTS
from piezod.recording.hold import STRAIGHT

Array = NDArray[np.float64]

DELAY = next(name for name, effect in EFFECTS.items() if effect.is_delay)
STEP = next(name for name, effect in EFFECTS.items() if effect.is_step)

TRIED = 7  # effects that are fitted in a round, first coarsely
TRIED_FROM_PAST = 3  # effects that are fitted from the base of the identification
REFINED = 4  # largest number of effects that are fitted thoroughly
COMPARED = 6  # largest number of hypotheses that are fitted to more samples
PAIRS = 4  # pairs of effects that are fitted
DELAYS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # delays [samples] that are tried with a feedthrough of the drive
NEAR = 0.4  # share of the best gain from which a hypothesis is fitted thoroughly, or to more samples
FEWEST_REFINED, FEWEST_COMPARED = 2, 3
COARSE_STEPS, FINE_STEPS = 7, 6  # Gauss-Newton steps of a coarse fit, and of a fit to more samples or of a variant
RACED_STEPS = 2  # Gauss-Newton steps after which only the best pairs continue
LEAST_GAIN = 0.01  # share of the loss; a candidate with a smaller first-order gain is not tried
PROMISING = 0.03  # share of the best first-order gain below which a candidate is not tried
SECOND_START = 0.3  # share of the first start's gain from which another start is tried


def with_each_effect(chain: Chain, fitted: Fitted, past: Point) -> list[tuple[Chain, Fitted]]:
    """Hypotheses with one more effect, each with the chain that it was fitted to.

    Two assumptions are tried too, since a missing effect may have caused them. A held command may be straight, unless
    an effect smooths it. A recording may start like those of the identification.
    """
    chains = [(chain, fitted)]
    if not chain.series[0].hold.straight and not any(term.effect.smooths for term in fitted.terms):
        straight = chain.like([replace(series, hold=STRAIGHT) for series in chain.series])
        chains.append((straight, fit(straight, fitted.terms, fitted.point, most_steps=FINE_STEPS)))
    trials = []
    for variant, known in chains:
        few = coarse(variant)
        tried = _tried(few, known, past)
        few.forget()
        trials += [(variant, hypothesis) for hypothesis in _fitted_finely(variant, known, tried)]
    restarted = with_equal_starts(chain)
    if restarted is not None:
        few = coarse(restarted)
        tried = _from_past(few, fitted, past)
        few.forget()
        trials += [(restarted, hypothesis) for hypothesis in _fitted_finely(restarted, fitted, tried)]
    return trials


def with_own_step(chain: Chain, fitted: Fitted, others: Sequence[Fitted]) -> list[tuple[Chain, Fitted]]:
    """Rivals of a step of the load (`others`), each with a step of its own.

    A lasting step may be fitted as a drift and a temporary step; then the drift is not recognised.
    """
    few = coarse(chain)
    starts = [(other, candidate) for other in others for candidate in suggested_steps(few, other)]
    tried = each(lambda start: _extended(few, *start), starts)
    few.forget()
    return [(chain, hypothesis) for hypothesis in _fitted_finely(chain, fitted, tried)]


def fitted_pairs(chain: Chain, fitted: Fitted) -> list[Fitted]:
    """Hypotheses with two more effects, of the most promising pairs with at least one specific effect."""
    few = coarse(chain)
    promising = screened_pairs(few, fitted.terms, fitted.point)
    least = _least_gain(few, fitted)
    pairs = [pair for pair in promising if pair[0].gain > least and any(_is_specific(effect) for effect in pair)]
    tried = each(lambda pair: fit(few, *_with_candidates(fitted, pair)), pairs[:PAIRS])
    tried = sorted(tried + _delayed_feedthroughs(few, fitted), key=_loss)
    for place in (len(fitted.terms), len(fitted.terms) + 1):
        tried = each(partial(_best_variant, few, place=place), tried[:FEWEST_REFINED])
    few.forget()
    return _fitted_finely(chain, fitted, tried)


def _is_specific(candidate: Candidate) -> bool:
    """Whether an effect fits few residuals; a soft effect fits any residual at low force."""
    effect = candidate.term.effect
    return not effect.flexible and not effect.soft


def _delayed_feedthroughs(chain: Chain, fitted: Fitted) -> list[Fitted]:
    """Hypotheses with a delay and a feedthrough: its jumps are a sample wide, so screening does not find the delay."""
    names = [name for name, effect in EFFECTS.items() if effect.is_delay or effect.narrow]
    if any(name in fitted.effects for name in names):
        return []
    dt_s = min(series.dt_s for series in chain.series)
    scopes: tuple[Scope, ...] = ("since", "already")
    starts = [
        (_candidate(DELAY, -1, {"delay_s": delay * dt_s}, scope), _candidate(narrow, -1, {}, other))
        for narrow in names
        if narrow != DELAY
        for delay in DELAYS
        for scope in scopes
        for other in scopes
    ]
    first = each(lambda pair: fit(chain, *_with_candidates(fitted, pair), most_steps=RACED_STEPS), starts)
    best = sorted(first, key=_loss)[:PAIRS]
    tried = each(lambda hypothesis: fit(chain, hypothesis.terms, hypothesis.point, most_steps=COARSE_STEPS), best)
    return sorted(tried, key=_loss)[:FEWEST_REFINED]


def _with_candidates(fitted: Fitted, candidates: Sequence[Candidate]) -> tuple[tuple[Term, ...], Point]:
    """Terms and start of a hypothesis with more effects."""
    terms = (*fitted.terms, *(candidate.term for candidate in candidates))
    values = (*fitted.point.values, *(candidate.values for candidate in candidates))
    return terms, replace(fitted.point, values=values)


def _least_gain(chain: Chain, fitted: Fitted) -> float:
    """Least first-order gain of a candidate that is tried [noise variance]."""
    samples = sum(float(s.counts[rows].sum()) for s, rows in zip(chain.series, chain.rows, strict=True))
    return LEAST_GAIN * fitted.loss * samples


def _fitted_finely(chain: Chain, before: Fitted, tried: Sequence[Fitted]) -> list[Fitted]:
    """Best of the coarse fits, fitted to more samples."""
    best = sorted(tried, key=_loss)
    limit = before.loss - NEAR * (before.loss - best[0].loss) if best else 0.0
    near = sum(hypothesis.loss < limit for hypothesis in best[:COMPARED])
    starts = [(h.terms, _with_edges_at_jumps(chain, h)) for h in best[: max(near, FEWEST_COMPARED)]]
    return each(lambda start: fit(chain, *start, most_steps=FINE_STEPS), starts)


def _with_edges_at_jumps(chain: Chain, fitted: Fitted) -> Point:
    """Point with the edges of a last step of the load moved to the jumps of the readings."""
    term, values = fitted.terms[-1], fitted.point.values[-1]
    if not term.effect.is_step:
        return fitted.point
    series = chain.series[term.series]
    without = replace(fitted.point, values=(*fitted.point.values[:-1], {**values, "step_N": 0.0}))
    residual_N = series.reading_N - chain.run(term.series, fitted.terms, without).reading_N
    late_s = shown_late_s(chain, fitted.terms, fitted.point)
    inside = {name: values[name] for name in ("on_s", "off_s") if 0.0 < values[name] < series.duration_s}
    moved = {name: edge_near(series, residual_N, at_s + late_s) - late_s for name, at_s in inside.items()}
    return replace(fitted.point, values=(*fitted.point.values[:-1], {**values, **moved}))


def _tried(chain: Chain, fitted: Fitted, past: Point) -> list[Fitted]:
    """Hypotheses with one more effect: all promising ones fitted in few steps, the best of them thoroughly.

    They start from the current hypothesis. Effects since the identification also start from the base of the
    identification (`past`), since a strong effect bends the base.
    """
    candidates = screened(chain, fitted.terms, fitted.point)
    least = _least_gain(chain, fitted)
    by_effect: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        if candidate.gain < max(PROMISING * candidates[0].gain, least):
            break
        if len(by_effect) < TRIED or candidate.term.effect.name in by_effect:
            by_effect.setdefault(candidate.term.effect.name, []).append(candidate)
    coarse_fits = each(
        lambda starts: (_extended(chain, fitted, starts[0], most_steps=COARSE_STEPS), starts), list(by_effect.values())
    )
    coarse_fits += [(hypothesis, []) for hypothesis in _from_past(chain, fitted, past)]
    best: dict[str, tuple[Fitted, list[Candidate]]] = {}
    for hypothesis, starts in sorted(coarse_fits, key=lambda coarse_fit: coarse_fit[0].loss):
        best.setdefault(hypothesis.effects[-1], (hypothesis, starts))
    ranked = list(best.values())
    limit = fitted.loss - NEAR * (fitted.loss - ranked[0][0].loss) if ranked else 0.0
    near = sum(hypothesis.loss < limit for hypothesis, _ in ranked[:REFINED])
    refined = max(near, FEWEST_REFINED)
    thorough = each(lambda coarse_fit: _refined(chain, fitted, *coarse_fit), ranked[:refined])
    steps = each(lambda candidate: _extended(chain, fitted, candidate), suggested_steps(chain, fitted))
    return [*thorough, *(hypothesis for hypothesis, _ in ranked[refined:]), *steps]


def _from_past(chain: Chain, fitted: Fitted, past: Point) -> list[Fitted]:
    """Hypotheses with one more effect since the identification, fitted from the base of the identification."""
    bases = [replace(past, values=fitted.point.values), *([fitted.point] if fitted.terms else [])]
    fall_N = -min(fitted.point.offsets_N[k] for k, series in enumerate(chain.series) if series.role == "recording")
    starts = [
        start for base in bases for start in since_identification(chain, fitted.terms, base, fall_N)[:TRIED_FROM_PAST]
    ]

    def from_base(start: tuple[Candidate, Point]) -> Fitted:
        candidate, base = start
        point = replace(base, values=(*base.values, candidate.values))
        return fit(chain, (*fitted.terms, candidate.term), point, most_steps=COARSE_STEPS)

    return each(from_base, starts)


def _refined(chain: Chain, fitted: Fitted, first: Fitted, starts: Sequence[Candidate]) -> Fitted:
    """Best fit of one effect, from up to three starts, in both scopes, with every choice."""
    best = fit(chain, first.terms, first.point)
    others = [
        start for start in starts[1:] if _differs(start, starts[0]) and start.gain > SECOND_START * starts[0].gain
    ]
    for start in others[:2]:
        best = min(best, _extended(chain, fitted, start), key=_loss)
    return _best_variant(chain, best, len(best.terms) - 1)


def _differs(first: Candidate, second: Candidate) -> bool:
    return (first.values, first.term.choices) != (second.values, second.term.choices)


def _best_variant(chain: Chain, best: Fitted, place: int) -> Fitted:
    """Best fit with the other scope or another choice of the effect at this place."""
    scopes: tuple[Scope, ...] = ("since", "already")
    for scope in scopes:
        if scope != best.terms[place].scope:
            best = min(best, _variant(chain, best, place, scope=scope), key=_loss)
    for parameter in best.terms[place].effect.parameters:
        for choice in parameter.search.choices:
            if (parameter.name, choice) not in best.terms[place].choices:
                best = min(best, _variant(chain, best, place, choice=(parameter.name, choice)), key=_loss)
    return best


def _extended(chain: Chain, fitted: Fitted, candidate: Candidate, most_steps: int = MOST_STEPS) -> Fitted:
    return fit(chain, *_with_candidates(fitted, (candidate,)), most_steps=most_steps)


def _variant(
    chain: Chain, fitted: Fitted, place: int, *, scope: Scope | None = None, choice: tuple[str, float] | None = None
) -> Fitted:
    """Hypothesis refitted with another scope or choice of the effect at this place."""
    term = fitted.terms[place]
    if scope is not None:
        term = replace(term, scope=scope)
    if choice is not None:
        term = replace(term, choices=tuple(choice if known[0] == choice[0] else known for known in term.choices))
    terms = (*fitted.terms[:place], term, *fitted.terms[place + 1 :])
    return fit(chain, terms, fitted.point, most_steps=FINE_STEPS)


def suggested_steps(chain: Chain, fitted: Fitted) -> list[Candidate]:
    """Steps of the load that the residuals of the diagnosed recordings suggest."""
    if STEP in fitted.effects:
        return []
    normal = Normal.at(chain, fitted.terms, fitted.point)
    modelled = normal.readings()
    candidates = []
    for number, series in enumerate(chain.series):
        if series.role == "identification":
            continue
        residual_N = series.reading_N - modelled[number]
        for step in (*likely_steps(normal, number), *jump_steps(series, residual_N)):
            end_s = NEVER_S if step.end == series.time_s.size else step.end * series.dt_s
            values = {"step_N": step.height_N, "on_s": step.first * series.dt_s, "off_s": end_s}
            visible = _candidate(STEP, number, values)
            point = replace(fitted.point, values=(*fitted.point.values, visible.values))
            late_s = shown_late_s(chain, (*fitted.terms, visible.term), point)
            values |= {name: values[name] - late_s for name in ("on_s", "off_s")}
            candidates.append(_candidate(STEP, number, values))
    return candidates


def _candidate(name: str, number: int, known: dict[str, float], scope: Scope = "once") -> Candidate:
    """Effect at its first start, except for `known` values."""
    effect = EFFECTS[name]
    values = {p.name: p.search.starts[0] for p in effect.parameters if not p.search.choices}
    choices = tuple((p.name, p.search.choices[0]) for p in effect.parameters if p.search.choices)
    return Candidate(Term(effect, scope, number, choices), {**values, **within_ranges(effect, known)})


def _loss(fitted: Fitted) -> float:
    return fitted.loss
