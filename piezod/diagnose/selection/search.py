"""Search: a hypothesis grows by the effect that explains most; then rivals are tried and redundant effects removed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from piezod.diagnose.candidates.screening import catalogue_starts
from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import (
    best_intersample,
    coarse,
    with_best_hold,
    with_refitted_starts,
    with_usual_start,
)
from piezod.diagnose.hypothesis.stack_change import NAMES, with_stack_changed
from piezod.diagnose.selection.acceptance import (
    BETTER,
    comparison_loss,
    degenerate,
    penalised_loss,
    steady_enough,
    worth,
)
from piezod.diagnose.selection.corners import with_corners
from piezod.diagnose.selection.given_effects import (
    classify_given,
    refitted_without,
    reordered,
    with_fitted_values,
    without,
)
from piezod.diagnose.selection.replay import Attempt
from piezod.diagnose.selection.search_state import Rivalry, Round, Search
from piezod.diagnose.selection.tone_search import dominates, strongest_tone, subtract, update_tones
from piezod.diagnose.selection.trials import fitted_pairs, with_each_effect, with_own_step
from piezod.effects import EFFECTS

OnProgress = Callable[[str, float], None]
Trial = tuple[Chain, Fitted]
"""Hypothesis with the recordings, holds and initial states that it was fitted to."""

MOST_EFFECTS = 5  # largest number of new effects
SEARCHED, FURTHER = 0.85, 0.5  # progress at the end of the search; factor by which each round shrinks the rest
BEST_TRIALS = 3  # accepted trials that are refitted with their own hold and initial states
STEP_RIVALS = 2  # rivals of a step of the load that are tried with a step of their own
SEVERAL, NEW_STARTS = 3, 2  # parameters of an effect that is refitted from other starts, and number of starts
BEST_PAIRS = 2  # pairs of effects that are refitted with their own hold and initial states
NOISE_LOSS = 1.05  # loss [noise variance] at which neither a pair nor a change of the stack is tried
NEARLY_ALL = 0.05  # share of the loss; a change of the stack that leaves less is accepted before any effect
RIVALS = 6  # rivals that are tried in place of an effect
RECONSIDERED = 3  # rejected trials with a smaller loss that are refitted with their own hold and initial states


def search(chain: Chain, start: Point, progress: OnProgress, given: tuple[Term, ...] = ()) -> Search:
    """Find the effects that the recordings show.

    Parameters
    ----------
    chain, start
        Recordings, and base with the values of the given effects.
    progress
        Called with the current step, and the share of the work that is done at least.
    given
        Effects of the given model, held at their values.
    """
    progress("fitting the base", 0.02)
    result = _begin(chain, start, given)
    while len(result.new) < MOST_EFFECTS:
        progress(f"looking for effect {len(result.new) + 1}", SEARCHED - (SEARCHED - 0.1) * FURTHER ** len(result.new))
        if not _extend(result):
            break
    progress("trying to swap and to drop", SEARCHED)
    replace_by_rivals(result)
    result.hypothesis, result.statuses = classify_given(result.chain, result.hypothesis, result.base)
    _remove_redundant(result)
    _fit_all_samples(result)
    return result


def _begin(chain: Chain, start: Point, given: tuple[Term, ...]) -> Search:
    """State before the first round: base, hold and initial states, with changes of the given effects and the stack.

    A model with effects states its hold; otherwise the best hold is determined.
    """
    if given:
        base = fit(chain, given, start)
    else:
        chain, base = best_intersample(chain, (), start)
        base = fit(chain, (), base.point)  # a base that has not converged would make any effect seem useful
    chain, base = with_usual_start(chain, base)
    result = Search(chain, base, base, _past(chain, start, given))
    while _change_given(result):
        pass
    return result


def _change_given(result: Search) -> bool:
    """Accept the best change of a given effect or of the stack, if one is worth it.

    Such changes come before new effects, since they are likelier. Without given effects a change of the stack must
    explain nearly all, since a new effect may explain the same.
    """
    names = [term.effect.name for term in result.hypothesis.terms if term.held]
    tried = [with_fitted_values(result.chain, result.hypothesis, name, result.past) for name in names]
    stack = None if result.stack_changed else with_stack_changed(result.chain, result.hypothesis, result.past)
    if stack is not None and (names or stack.loss < NEARLY_ALL * result.hypothesis.loss):
        tried.append(stack)
    best = min(tried, key=_loss, default=result.hypothesis)
    if best is result.hypothesis or not worth(result.hypothesis, best):
        return False
    result.hypothesis = best
    return True


def _extend(result: Search) -> bool:
    """One round: accept a tone, corners of the base, a change of the stack, an effect or a pair; False if none."""
    tone = strongest_tone(result)
    if tone is not None and dominates(result, tone):
        subtract(result, tone)
        return True
    tried = with_each_effect(result.chain, result.hypothesis, result.past) + _with_step_of_rivals(result)
    best = min(_best_trials(result, tried), key=lambda trial: penalised_loss(trial[1]), default=None)
    if tone is not None and (best is None or tone[1].loss < best[1].loss):
        subtract(result, tone)
    elif (cornered := _with_corners(result, best)) is not None:
        _accept_corners(result, *cornered)
    elif _change_stack(result, best):
        pass
    elif best is not None:
        _accept(result, tried, best)
    elif add_pair(result, tried):
        update_tones(result)
    else:
        return False
    return True


def _accept(result: Search, tried: Sequence[Trial], best: Trial) -> None:
    """Accept an effect, unless its gain is due to another hold or other initial states: then accept only these."""
    before = _without_effect(result, best)
    if before is not result.hypothesis:
        result.base = fit(best[0], result.base.terms, result.base.point)
        if not worth(before, best[1]):
            result.chain, result.hypothesis = best[0], before
            return
    result.chain, result.hypothesis = best
    name = best[1].effects[-1]
    others = tuple(h for chain, h in tried if h.effects[-1] != name and not degenerate(chain, h))
    result.rounds.append(Round(before, result.hypothesis, others))
    refit_earlier_effects(result)
    update_tones(result)


def _change_stack(result: Search, best: Trial | None) -> bool:
    """Accept a change of gain and loops of the stack, if no effect explains as much."""
    if result.stack_changed or result.hypothesis.loss <= NOISE_LOSS:
        return False
    changed = with_stack_changed(result.chain, result.hypothesis, result.past)
    if not worth(result.hypothesis, changed) or (best is not None and BETTER * changed.loss > best[1].loss):
        return False
    result.hypothesis = changed
    return True


def _best_trials(result: Search, tried: list[Trial]) -> list[Trial]:
    """Accepted trials with the least loss, each refitted with its own hold and initial states.

    A rejected trial with a smaller loss is refitted likewise and compared again, since its hold and initial states were
    estimated without its effect. A trial is compared with the current hypothesis on its own hold and initial states:
    initial states that were estimated without an effect may explain most of it.
    """
    before = {id(result.chain): result.hypothesis}
    for chain, _ in tried:
        if id(chain) not in before:
            before[id(chain)] = fit(chain, result.hypothesis.terms, result.hypothesis.point, most_steps=6)

    def is_accepted(trial: Trial) -> bool:
        chain, after = trial
        reference = before.get(id(chain), result.hypothesis)
        return after.loss < BETTER * result.hypothesis.loss and _accepts(chain, reference, after)

    tried = sorted(tried, key=lambda trial: trial[1].loss)
    accepted = []
    for chain, after in tried:
        good = is_accepted((chain, after))
        accepted += [(chain, after)] * good
        result.attempts.append(
            Attempt(
                "one", len(result.names), before[id(chain)], after, degenerate=degenerate(chain, after), accepted=good
            )
        )
    limit = accepted[0][1].loss if accepted else result.hypothesis.loss
    rejected = [trial for trial in tried if trial[1].loss < limit and not degenerate(*trial)][:RECONSIDERED]
    refitted = [trial for trial in each(with_refitted_starts, rejected) if trial is not None and is_accepted(trial)]
    return each(with_best_hold, sorted(accepted + refitted, key=lambda trial: trial[1].loss)[:BEST_TRIALS])


def _accepts(chain: Chain, before: Fitted, after: Fitted) -> bool:
    """Whether the last effect is plausible and gains enough."""
    return not degenerate(chain, after) and worth(before, after) and steady_enough(before, after)


def add_pair(result: Search, tried: Sequence[Trial]) -> bool:
    """Accept two effects at once, if each is accepted only with the other; False if there is no such pair."""
    if len(result.new) + 2 > MOST_EFFECTS or result.hypothesis.loss <= NOISE_LOSS:
        return False
    pairs = [pair for pair in fitted_pairs(result.chain, result.hypothesis) if worth(result.hypothesis, pair)]
    best_pairs = sorted(pairs, key=penalised_loss)[:BEST_PAIRS]
    accepted = []
    for chain, pair in each(with_best_hold, [(result.chain, pair) for pair in best_pairs]):
        count = len(pair.terms)
        orders = pair, reordered(pair, [*range(count - 2), count - 1, count - 2])
        firsts = [fit(chain, h.terms[:-1], replace(h.point, values=h.point.values[:-1])) for h in orders]
        both = zip(firsts, orders, strict=True)
        good = worth(result.hypothesis, pair) and all(_accepts(chain, *comparison) for comparison in both)
        accepted += [(chain, firsts[0], pair)] * good
        is_degenerate = any(degenerate(chain, hypothesis) for hypothesis in orders)
        result.attempts.append(
            Attempt("pair", len(result.names), result.hypothesis, pair, degenerate=is_degenerate, accepted=good)
        )
    if not accepted:
        return False
    chain, first, pair = min(accepted, key=lambda trial: penalised_loss(trial[2]))
    single = [h for on, h in tried if on is result.chain and worth(result.hypothesis, h) and not degenerate(on, h)]
    others = tuple(h for h in single if h.effects[-1] not in pair.effects)
    result.rounds += [Round(result.hypothesis, first, others), Round(first, pair, ())]
    if chain is not result.chain:
        result.chain, result.base = chain, fit(chain, result.base.terms, result.base.point)
    result.hypothesis = pair
    return True


def _with_corners(result: Search, best: Trial | None) -> Trial | None:
    """Hypothesis with corners in the base, if they explain more than any effect; an effect would only imitate them.

    Corners are chosen from all recordings only if no effect is left that may bend them.
    """
    limit = min(BETTER * result.hypothesis.loss, np.inf if best is None else best[1].loss)
    for by_all in (False, True) if best is None else (False,):
        cornered = with_corners(result.chain, result.hypothesis, by_all=by_all)
        if cornered is not None and cornered[1].loss < limit:
            return cornered
    return None


def _accept_corners(result: Search, chain: Chain, fitted: Fitted) -> None:
    result.chain, result.hypothesis = chain, fitted
    result.fit_base()
    result.past = _past(chain, result.base.point, result.base.terms)


def _with_step_of_rivals(result: Search) -> list[Trial]:
    """Best rivals of the last effect, each with a step of its own, if the last effect is a step of the load."""
    if not result.rounds or result.hypothesis.effects[-1:] != ("load_step",):
        return []
    if not result.rounds[-1].accepted.point.alike(result.hypothesis.point):
        return []  # they were fitted before the base had corners
    others = sorted(result.rounds[-1].others, key=_loss)
    return with_own_step(result.chain, result.hypothesis, others[:STEP_RIVALS])


def _without_effect(result: Search, best: Trial) -> Fitted:
    """Current hypothesis, on the hold and initial states of the trial if it fits better there."""
    if best[0] is result.chain:
        return result.hypothesis
    refitted = fit(best[0], result.hypothesis.terms, result.hypothesis.point)
    return refitted if refitted.loss < BETTER * result.hypothesis.loss else result.hypothesis


def refit_earlier_effects(result: Search) -> None:
    """Refit each earlier effect with the other scope, with other choices, and from other starts.

    An effect that was fitted before the last one may have imitated it, and would keep that shape.
    """
    few, fitted = coarse(result.chain), result.hypothesis
    known = fit(few, fitted.terms, fitted.point, most_steps=2)
    variants = []
    for place, term in enumerate(fitted.terms[:-1]):
        if term.effect.name in (*result.given, *NAMES):
            continue
        values = fitted.point.values[place]
        changed = [(replace(term, choices=choices), values) for choices in _other_choices(term)]
        if term.scope != "once":
            changed.append((replace(term, scope="since" if term.scope == "already" else "already"), values))
        forms = (term, *(form for form, _ in changed))
        changed += [(form, start) for form in forms for start in _starts(few, term)]
        variants += [_exchanged(fitted, place, *variant) for variant in changed]
    tried = each(lambda variant: fit(few, *variant, most_steps=6), variants)
    best = min(tried, key=_loss, default=known)
    if best.loss < BETTER * known.loss:
        result.hypothesis = fit(result.chain, best.terms, best.point)


def _exchanged(fitted: Fitted, place: int, term: Term, values: Mapping[str, float]) -> tuple[tuple[Term, ...], Point]:
    """Hypothesis with another term and values at a place."""
    terms = (*fitted.terms[:place], term, *fitted.terms[place + 1 :])
    point = replace(fitted.point, values=(*fitted.point.values[:place], values, *fitted.point.values[place + 1 :]))
    return terms, point


def _starts(chain: Chain, term: Term) -> list[dict[str, float]]:
    """Other starts of an effect with several parameters, of which one may compensate another."""
    if term.scope == "once" or len(term.searched) < SEVERAL:
        return []
    starts = [values for effect, values, _ in catalogue_starts(chain, [], {}) if effect is term.effect]
    return starts[:NEW_STARTS]


def _other_choices(term: Term) -> list[tuple[tuple[str, float], ...]]:
    """Choices of an effect with one of them changed."""
    return [
        tuple((name, value) if name == parameter.name else (name, chosen) for name, chosen in term.choices)
        for parameter in term.effect.parameters
        for value in parameter.search.choices
        if (parameter.name, value) not in term.choices
    ]


def _fit_all_samples(result: Search) -> None:
    """Fit hypothesis and base once more, to all samples."""
    series = result.chain.series
    result.chain = result.chain.like(series, max(int(s.time_s.size) for s in series))
    result.hypothesis = fit(result.chain, result.hypothesis.terms, result.hypothesis.point)
    result.base = fit(result.chain, result.base.terms, result.base.point, most_steps=4)


def _past(chain: Chain, start: Point, given: tuple[Term, ...]) -> Point:
    """Base fitted to the identification recordings, with the other recordings' offsets 0."""
    known = [k for k, series in enumerate(chain.series) if series.role == "identification"]
    identification = chain.like([chain.series[k] for k in known])
    point = fit(identification, given, start.of(known)).point
    offsets_N, starts = np.zeros(len(chain.series)), list(start.starts)
    offsets_N[known] = point.offsets_N
    for k, fitted_start in zip(known, point.starts, strict=True):
        starts[k] = fitted_start
    return replace(point, offsets_N=offsets_N, starts=tuple(starts))


def replace_by_rivals(result: Search) -> None:
    """Replace each effect by the rival with which the final hypothesis fits better, if there is one."""
    if len(result.hypothesis.effects) == 1 and not EFFECTS[result.hypothesis.effects[0]].general:
        return
    for name in [name for name in result.hypothesis.effects if name not in result.given]:
        rivals = _rivals(result, name)
        if not rivals:
            continue
        reduced = refitted_without(result.chain, result.hypothesis, name)
        few = coarse(result.chain)
        tried = each(partial(_with_rival, few, result.hypothesis, name, most_steps=4), rivals)
        few.forget()
        best = sorted(tried, key=_loss)[:2]
        replaced = each(partial(_with_rival, result.chain, result.hypothesis, name), best)
        accepted = {h.effects[-1]: h for h in replaced if worth(reduced, h) and not degenerate(result.chain, h)}
        losses = {name: comparison_loss(name, reduced.loss, result.hypothesis.loss)}
        losses |= {h.effects[-1]: np.inf for h in replaced}
        losses |= {rival: comparison_loss(rival, reduced.loss, h.loss) for rival, h in accepted.items()}
        chosen = min(losses, key=lambda effect: losses[effect])
        if losses[chosen] < BETTER * losses[name]:
            result.hypothesis = accepted[chosen]
        else:
            chosen = name
        result.rivalries[chosen] = Rivalry(reduced.loss, losses.pop(chosen), losses)


def with_each_rival(result: Search, name: str) -> list[Fitted]:
    """Hypothesis with each plausible rival in place of an effect."""
    fitted = each(partial(_with_rival, result.chain, result.hypothesis, name), _rivals(result, name))
    return [hypothesis for hypothesis in fitted if not degenerate(result.chain, hypothesis)]


def _rivals(result: Search, name: str) -> list[Fitted]:
    """Trials of the round that accepted an effect, without effects found since: the best with each, by loss."""
    tried = [h for round_ in result.rounds if round_.accepted.effects[-1] == name for h in round_.others]
    best: dict[str, Fitted] = {}
    for hypothesis in sorted(tried, key=_loss):
        if hypothesis.effects[-1] not in result.hypothesis.effects:
            best.setdefault(hypothesis.effects[-1], hypothesis)
    return list(best.values())[:RIVALS]


def _with_rival(chain: Chain, fitted: Fitted, name: str, rival: Fitted, most_steps: int = MOST_STEPS) -> Fitted:
    """Hypothesis with the last effect of `rival` in place of the effect `name`."""
    terms, values = without(fitted, name)
    places = [k for k, term in enumerate(rival.terms) if term.effect.name == rival.effects[-1]]
    terms += [rival.terms[k] for k in places]
    values += [rival.point.values[k] for k in places]
    return fit(chain, terms, replace(fitted.point, values=tuple(values)), most_steps=most_steps)


def _remove_redundant(result: Search) -> None:
    """Remove effects that the final base and the other effects have made redundant."""
    names = [name for name in result.hypothesis.effects if name not in result.given]
    while names:
        reduced = refitted_without(result.chain, result.hypothesis, names.pop(0))
        required = worth(reduced, result.hypothesis)
        result.attempts.append(
            Attempt("drop", len(result.names), reduced, result.hypothesis, degenerate=False, accepted=required)
        )
        if not required:
            result.hypothesis = reduced
            names = [name for name in reduced.effects if name not in result.given]


def _loss(fitted: Fitted) -> float:
    return fitted.loss
