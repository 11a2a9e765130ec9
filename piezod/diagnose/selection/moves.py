"""The moves of a search: each makes the next state from the candidates, or None where it does not apply.

`MOVES` is their order. A move applies only where no earlier one did.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.starts import catalogue_starts
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import coarse, fit_from_each, with_best_hold
from piezod.diagnose.hypothesis.stack_change import NAMES, with_stack_changed
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import (
    accepted,
    comparison_loss,
    degenerate,
    highest_accepted_loss,
    loss_by_choices,
    penalised_loss,
    worth,
)
from piezod.diagnose.selection.candidates import Candidates, Trial
from piezod.diagnose.selection.corners import with_corners
from piezod.diagnose.selection.given_effects import reordered
from piezod.diagnose.selection.replay import Attempt
from piezod.diagnose.selection.search_state import Round, Search
from piezod.diagnose.selection.tone_search import dominates, subtract, update_tones
from piezod.diagnose.selection.trials import fitted_pairs

PAIRS_WITH_HOLDS = 2  # pairs that are tried with every hold of the command
SEVERAL, OTHER_STARTS = 3, 2  # an effect with three parameters is also refitted from so many starts of the catalogue

Move = Callable[[Candidates], Search | None]


def subtract_dominant_tone(candidates: Candidates) -> Search | None:
    """Remove a tone that is most of the loss, before effects are tried."""
    state, tone = candidates.state, candidates.tone
    return subtract(state, tone) if tone is not None and dominates(state, tone) else None


def subtract_best_tone(candidates: Candidates) -> Search | None:
    """Remove a tone that gains more than any effect."""
    tone, best = candidates.tone, candidates.best
    if tone is None or (best is not None and tone.fitted.loss >= best[1].loss):
        return None
    return subtract(candidates.state, tone)


def add_corners(candidates: Candidates) -> Search | None:
    """Add corners to the base where they gain more than any effect: an effect would be named for their sake.

    All recordings choose them only where no effect is left that may bend them.
    """
    state, best = candidates.state, candidates.best
    if state.hypothesis.loss <= RULES.at_noise:
        return None
    limit = min(RULES.better * state.hypothesis.loss, np.inf if best is None else best[1].loss)
    for by_all in (False, True) if best is None else (False,):
        sharp = with_corners(state.chain, state.hypothesis, by_all=by_all)
        if sharp is not None and sharp[1].loss < limit:
            return state.with_corners(*sharp)
    return None


def change_stack(candidates: Candidates) -> Search | None:
    """Change gain and loops of the stack since the identification, where no effect explains as much."""
    state, best = candidates.state, candidates.best
    if state.stack_changed or state.hypothesis.loss <= RULES.at_noise:
        return None
    limit = highest_accepted_loss(state.hypothesis) if best is None else best[1].loss / RULES.better
    changed = with_stack_changed(state.chain, state.hypothesis, state.past, limit)
    if changed is None or changed[1].loss > limit or not worth(state.hypothesis, changed[1]):
        return None
    return state.on_chain(*changed)


def add_pair(candidates: Candidates) -> Search | None:
    """Add two effects at once where no single one is accepted, because each leaves what the other explains.

    Each must be accepted beside the other.
    """
    state, tried = candidates.state, candidates.tried
    if (
        candidates.best is not None
        or len(state.new) + 2 > RULES.most_effects
        or state.hypothesis.loss <= RULES.at_noise
    ):
        return None
    pairs = [pair for pair in fitted_pairs(state.chain, state.hypothesis) if worth(state.hypothesis, pair)]
    promising = [(state.chain, pair) for pair in sorted(pairs, key=penalised_loss)[:PAIRS_WITH_HOLDS]]
    accepted_pairs = []
    for chain, pair in each(with_best_hold, promising):
        count = len(pair.terms)
        orders = pair, reordered(pair, [*range(count - 2), count - 1, count - 2])
        starts = [(one.terms[:-1], replace(one.point, values=one.point.values[:-1])) for one in orders]
        firsts = [fit_from_each(chain, terms, [start]) for terms, start in starts]
        both = zip(firsts, orders, strict=True)
        good = worth(state.hypothesis, pair) and all(accepted(chain, *order) for order in both)
        accepted_pairs += [(chain, firsts[0], pair)] * good
        unlike = any(degenerate(chain, order) for order in orders)
        attempt = Attempt("pair", len(state.names), state.hypothesis, pair, degenerate=unlike, accepted=good)
        candidates.attempts.append(attempt)
    if not accepted_pairs:
        return None
    chain, first, pair = min(accepted_pairs, key=lambda result: _pair_loss(state, result[2]))
    single = [
        one for on, one in tried if on is state.chain and worth(state.hypothesis, one) and not degenerate(on, one)
    ]
    others = tuple(one for one in single if one.effects[-1] not in pair.effects)
    rounds = (*state.rounds, Round(state.hypothesis, first, others), Round(first, pair, ()))
    base = state.base if chain is state.chain else fit(chain, state.base.terms, state.base.point)
    return update_tones(replace(state, chain=chain, base=base, hypothesis=pair, rounds=rounds))


def _pair_loss(state: Search, pair: Fitted) -> float:
    """Loss by which a pair is compared with others; that of a general effect is raised."""
    return max(comparison_loss(term.effect.name, state.hypothesis.loss, pair.loss) for term in pair.terms[-2:])


def add_effect(candidates: Candidates) -> Search | None:
    """Add the best accepted effect; where only its hold or its initial states gain, take these without it."""
    state, best = candidates.state, candidates.best
    if best is None:
        return None
    chain, after = best
    before = _without_it(state, best)
    base = state.base
    if before is not state.hypothesis:
        base = fit(chain, base.terms, base.point)
        if not worth(before, after):
            return replace(state, chain=chain, hypothesis=before, base=base)
    others = tuple(
        one for on, one in candidates.tried if one.effects[-1] != after.effects[-1] and not degenerate(on, one)
    )
    rounds = (*state.rounds, Round(before, after, others))
    return update_tones(refit_earlier_effects(replace(state, chain=chain, hypothesis=after, base=base, rounds=rounds)))


def _without_it(state: Search, best: Trial) -> Fitted:
    """Hypothesis so far; on the chain of a new effect where it fits better there."""
    if best[0] is state.chain:
        return state.hypothesis
    without = fit(best[0], state.hypothesis.terms, state.hypothesis.point)
    return without if without.loss < RULES.better * state.hypothesis.loss else state.hypothesis


def refit_earlier_effects(state: Search) -> Search:
    """State with an earlier effect in another scope, with another choice or from another start, where that gains.

    An effect that was fitted without the last one may have taken on its shape, and stays there. The choices of the last
    one were compared before its fit had arrived.
    """
    few, fitted = coarse(state.chain), state.hypothesis
    known = fit(few, fitted.terms, fitted.point, most_steps=2)
    variants = []
    for place, term in enumerate(fitted.terms[:-1]):
        if term.effect.name in (*state.given, *NAMES):
            continue
        values = fitted.point.values[place]
        terms = [replace(term, choices=choices) for choices in _other_choices(term)]
        if term.scope != "once":
            terms.append(replace(term, scope="since" if term.scope == "already" else "already"))
        starts = _starts(few, term)
        settings = [(other, values) for other in terms] + [
            (other, start) for other in (term, *terms) for start in starts
        ]
        variants += [_with_term(fitted, place, *setting) for setting in settings]
    if fitted.loss > RULES.at_noise:
        last, values = fitted.terms[-1], fitted.point.values[-1]
        others = [replace(last, choices=choices) for choices in _other_choices(last)]
        variants += [_with_term(fitted, len(fitted.terms) - 1, other, values) for other in others]
    tried = each(lambda variant: fit(few, *variant, most_steps=6), variants)
    best = min(tried, key=loss_by_choices, default=known)
    if best.loss >= RULES.better * known.loss:
        return state
    return replace(state, hypothesis=fit(state.chain, best.terms, best.point))


def _with_term(fitted: Fitted, place: int, term: Term, values: Mapping[str, float]) -> tuple[tuple[Term, ...], Point]:
    """Terms and point of a hypothesis with another term at a place."""
    terms = (*fitted.terms[:place], term, *fitted.terms[place + 1 :])
    point = replace(fitted.point, values=(*fitted.point.values[:place], values, *fitted.point.values[place + 1 :]))
    return terms, point


def _starts(chain: Chain, term: Term) -> list[dict[str, float]]:
    """Starts of an effect with several parameters: one may stand in for another."""
    if term.scope == "once" or len(term.searched) < SEVERAL:
        return []
    ideas = [values for effect, values, choices in catalogue_starts(chain, [], {}) if effect.name == term.effect.name]
    return ideas[:OTHER_STARTS]


def _other_choices(term: Term) -> Sequence[tuple[tuple[str, float], ...]]:
    """Choices of an effect with one of them changed."""
    return [
        tuple((name, value) if name == parameter.name else (name, chosen) for name, chosen in term.choices)
        for parameter in term.effect.parameters
        for value in parameter.search.choices
        if (parameter.name, value) not in term.choices
    ]


MOVES: tuple[Move, ...] = (subtract_dominant_tone, subtract_best_tone, add_corners, change_stack, add_pair, add_effect)
