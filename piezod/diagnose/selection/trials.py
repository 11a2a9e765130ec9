"""Trials of further effects: the few with the smallest estimated losses are fitted, the best of them thoroughly."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from piezod.diagnose.candidates.screening import Estimate, Screening
from piezod.diagnose.candidates.starts import Candidate, within_ranges
from piezod.diagnose.candidates.steps import NEVER_S, edge_near, jump_steps, likely_steps, shown_late_s
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, Normal, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import COARSE_STEPS, FINE_STEPS, coarse, with_equal_starts
from piezod.diagnose.hypothesis.terms import Point, Scope, Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import loss_by_choices
from piezod.diagnose.selection.linear_gain import LinearGains
from piezod.effects import EFFECTS
from piezod.recording.hold import STRAIGHT

STEP = next(name for name, effect in EFFECTS.items() if effect.is_step)

TRIED, FROM_PAST, FEWEST_TRIED = 4, 2, 3
"""Effects that are fitted coarsely, from the old base too, and at least: lag, filter and delay are alike, and with one
fewer a lag of the concealed cases was missed."""
PAIRS, REFINED = 6, 2  # pairs that are fitted coarsely; hypotheses of which other choices are tried
COMPARED, FEWEST_COMPARED = 4, 3  # hypotheses that are fitted to more samples, and at least so many
NEAR = 0.4  # share of the best gain from which an effect is fitted, coarsely or to more samples
BOTH_SCOPES = 1.15  # loss of a scope relative to the other scope, up to which both are fitted
ASSUMED = 0.97  # loss with another assumption relative to the best one without it, below which it is tried
FAR = 3.0  # loss above which effects are also fitted from the base of the identification, since they have bent the base
CHOICE_STEPS = 4  # Gauss-Newton steps with another choice
LEAST_GAIN = 0.01  # share of the loss; an effect with a smaller estimated gain is not tried


def with_each_effect(chain: Chain, fitted: Fitted, past: Point) -> list[tuple[Chain, Fitted]]:
    """Hypotheses with one more effect, each with the chain that it was fitted to.

    Two assumptions are tried too where they lower the estimated loss, since a missing effect may have caused them. A
    held command may be straight, unless an effect smooths it. A recording may start like the identification recordings.
    """
    variants = []
    if not chain.series[0].hold.straight and not any(term.effect.smooths for term in fitted.terms):
        variants.append(chain.like([replace(series, hold=STRAIGHT) for series in chain.series]))
    restarted = with_equal_starts(chain)
    variants += [restarted] if restarted is not None else []
    few, assumed = coarse(chain), [coarse(variant) for variant in variants]
    screening = Screening(few, fitted.terms, fitted.point, assumed)
    chosen = _chosen(screening)
    tried = [(chain, fitted, _tried(screening, chosen, fitted, past))]
    few.forget()
    alone = min((estimate.loss for estimate in chosen), default=screening.loss)
    for number, (variant, other) in enumerate(zip(variants, assumed, strict=True)):
        if min((screening.loss_under(number, estimate) for estimate in chosen), default=np.inf) < ASSUMED * alone:
            known = fit(variant, fitted.terms, fitted.point, most_steps=FINE_STEPS)
            there = Screening(other, known.terms, known.point)
            tried.append((variant, known, _tried(there, _chosen(there), known, past)))
        other.forget()
    return [(on, hypothesis) for on, known, coarsely in tried for hypothesis in _fitted_finely(on, known, coarsely)]


def _chosen(screening: Screening) -> list[Estimate]:
    """Best starts of the effects with the smallest estimated losses, in both scopes where these are alike."""
    singles = [estimate for estimate in screening.singles if estimate.loss < (1.0 - LEAST_GAIN) * screening.loss]
    limit = screening.loss - NEAR * (screening.loss - singles[0].loss) if singles else 0.0
    best: dict[str, list[Estimate]] = {}
    for estimate in singles:
        known = best.setdefault(estimate.name, []) if len(best) < TRIED else best.get(estimate.name)
        if known is None or (len(best) > FEWEST_TRIED and not known and estimate.loss > limit):
            continue
        scopes = [one.candidates[-1].term.scope for one in known]
        if estimate.candidates[-1].term.scope not in scopes and (
            not known or estimate.loss < BOTH_SCOPES * known[0].loss
        ):
            known.append(estimate)
    return [estimate for estimates in best.values() for estimate in estimates]


def _tried(screening: Screening, chosen: Sequence[Estimate], fitted: Fitted, past: Point) -> list[Fitted]:
    """Hypotheses with one more effect, fitted coarsely; other choices of the best of them.

    While the loss is large, some start from the base of the identification (`past`): a strong effect bends the base.
    """
    chain = screening.chain
    starts = [screening.start(estimate) for estimate in chosen]
    if screening.loss > FAR:
        old = Screening(chain, fitted.terms, replace(past, values=fitted.point.values))
        starts += [old.start(estimate) for estimate in _chosen(old)[:FROM_PAST]]
    steps = [_with_candidate(fitted, candidate) for candidate in suggested_steps(chain, fitted)]
    linear = LinearGains(chain, fitted)
    steps = [step for step in steps if linear.may_gain(*step)]
    tried = _fitted_coarsely(chain, [*starts, *steps])
    return _with_other_choices(chain, tried)


def _fitted_coarsely(chain: Chain, starts: Sequence[tuple[tuple[Term, ...], Point]]) -> list[Fitted]:
    """Best coarse fit of each effect, the best first."""
    fitted = each(lambda start: fit(chain, *start, most_steps=COARSE_STEPS, robust=False), starts)
    best: dict[tuple[str, ...], Fitted] = {}
    for hypothesis in sorted(fitted, key=_loss):
        best.setdefault(hypothesis.effects, hypothesis)
    return list(best.values())


def _with_other_choices(chain: Chain, tried: Sequence[Fitted], last: int = 1) -> list[Fitted]:
    """Hypotheses, the best of them with the best scope and choices of their last effects."""
    best = [fitted for fitted in tried[:REFINED] if fitted.loss < RULES.far_behind * tried[0].loss]
    for back in range(last, 0, -1):
        best = each(partial(_best_variant, chain, back=back), best)
    return sorted([*best, *tried[len(best) :]], key=_loss)


def with_own_step(chain: Chain, fitted: Fitted, others: Sequence[Fitted]) -> list[tuple[Chain, Fitted]]:
    """Rivals of a step of the load (`others`), each with a step of its own.

    A lasting step may be fitted as a drift and a temporary step; then the drift is not recognised.
    """
    few = coarse(chain)
    starts = [_with_candidate(other, step) for other in others for step in suggested_steps(few, other)]
    tried = each(lambda start: fit(few, *start, most_steps=COARSE_STEPS, robust=False), starts)
    few.forget()
    return [(chain, hypothesis) for hypothesis in _fitted_finely(chain, fitted, tried)]


def fitted_pairs(chain: Chain, fitted: Fitted) -> list[Fitted]:
    """Hypotheses with two more effects, of the most promising pairs with at least one specific effect."""
    few = coarse(chain)
    screening = Screening(few, fitted.terms, fitted.point)
    limit = (1.0 - LEAST_GAIN) * screening.loss
    pairs = [pair for pair in screening.pairs if pair.loss < limit and any(map(_is_specific, pair.candidates))]
    tried = _fitted_coarsely(few, [screening.start(pair) for pair in pairs[:PAIRS]])
    tried = _with_other_choices(few, tried, last=2)
    few.forget()
    return _fitted_finely(chain, fitted, tried)


def _is_specific(candidate: Candidate) -> bool:
    """Whether an effect fits few residuals; a soft effect fits any residual at low force."""
    effect = candidate.term.effect
    return not effect.flexible and not effect.soft


def _with_candidate(fitted: Fitted, candidate: Candidate) -> tuple[tuple[Term, ...], Point]:
    """Terms and start of a hypothesis with one more effect."""
    return (*fitted.terms, candidate.term), replace(fitted.point, values=(*fitted.point.values, candidate.values))


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


def _best_variant(chain: Chain, best: Fitted, back: int) -> Fitted:
    """Best fit with the other scope or another choice of an effect, counted from the last one, 1."""
    place = len(best.terms) - back
    scopes: tuple[Scope, ...] = ("since", "already")
    for scope in scopes:
        if scope != best.terms[place].scope:
            best = min(best, _variant(chain, best, place, scope=scope), key=_loss)
    for parameter in best.terms[place].effect.parameters:
        for choice in parameter.search.choices:
            if (parameter.name, choice) not in best.terms[place].choices:
                best = min(best, _variant(chain, best, place, choice=(parameter.name, choice)), key=loss_by_choices)
    return best


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
    return fit(chain, terms, fitted.point, most_steps=CHOICE_STEPS, robust=False)


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
