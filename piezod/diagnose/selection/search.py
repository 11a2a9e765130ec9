"""The search: from the given model, one move after the other; at the end effects are exchanged and left out.

A state never changes, and a move makes a new one (`moves.py`). Every constant that decides stands in `rules.py`.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from piezod.diagnose.candidates.screening import Screening
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.sampling import best_intersample, coarse, with_usual_start
from piezod.diagnose.hypothesis.stack_change import GAIN, LOOPS, NAMES, with_stack_changed
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.diagnose.prepare import with_loose_base, with_tight_base
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import highest_accepted_loss, worth
from piezod.diagnose.selection.candidates import Candidates
from piezod.diagnose.selection.finish import fit_all_samples, remove_redundant, replace_by_rivals
from piezod.diagnose.selection.given_effects import classify_given, with_fitted_values
from piezod.diagnose.selection.linear_gain import LinearGains, is_near
from piezod.diagnose.selection.moves import MOVES
from piezod.diagnose.selection.search_state import Search, identified_base
from piezod.diagnose.selection.tone_search import strongest_tone, without_known_tones
from piezod.diagnose.selection.trials import suggested_steps
from piezod.model.information import Information

OnProgress = Callable[[str, float | None], None]


def search(
    chain: Chain,
    start: Point,
    progress: OnProgress,
    given: tuple[Term, ...] = (),
    until_s: float = np.inf,
    known: Information | None = None,
    known_tones_Hz: tuple[float, ...] = (),
    predicted: float = np.inf,
) -> Search:
    """Find the effects that the recordings show.

    Parameters
    ----------
    start
        Point to begin from, with the values of the given effects.
    progress
        Called with the current step in words, and None: the number of effects determines the time.
    given
        Effects of the given model, held at their values.
    until_s
        Monotonic time at which the search ends [s]; an effect that is not compared by then is not taken.
    known
        Information of the given model on its parameters; None: it states none.
    known_tones_Hz
        Frequencies of the given model's tones.
    predicted
        Error of the given model's own simulation over the noise of the recordings [1].
    """
    progress("fitting the base", None)
    state = replace(_begun(chain.within(until_s), start, given), known=known, predicted=predicted)
    state = without_known_tones(replace(state, known_tones_Hz=known_tones_Hz))
    if not state.has_known or not _is_unchanged(state):
        state = _with_moves(_with_refined_base(_with_changes(state)), progress)
    state = replace(state, chain=state.chain.within(np.inf), ended_early=state.chain.is_late)
    if not state.ended_early:
        progress("comparing with rivals, leaving out what gains nothing", None)
        state = replace_by_rivals(state)
    count = len(state.given) + len(known_tones_Hz) + (len(NAMES) if state.stack_changed else 0)
    tight = with_tight_base(state.chain, chain)
    now = classify_given(state.chain, tight, state.hypothesis, state.base, known, count, state.least_gain)
    state = replace(state, hypothesis=now.hypothesis, statuses=now.statuses, refined=now.refined)
    return fit_all_samples(remove_redundant(state))


def _with_moves(state: Search, progress: OnProgress) -> Search:
    """State after one move after the other, until none applies or the time is over."""
    while len(state.new) < RULES.most_effects:
        count = len(state.new)
        progress(f"looking for effect {count + 1}, at most {RULES.most_effects}", None)
        candidates = Candidates(state)
        following = next((moved for move in MOVES if (moved := move(candidates)) is not None), None)
        if state.chain.is_late or following is None:
            return replace(state, attempts=(*state.attempts, *candidates.attempts))
        state = replace(following, attempts=(*state.attempts, *candidates.attempts))
    return state


def _begun(chain: Chain, start: Point, given: tuple[Term, ...]) -> Search:
    """State before the first round: hold and initial states of the base.

    A model with effects states its hold.
    """
    if given:
        base = fit(chain, given, start)
    else:
        chain, base = best_intersample(chain, (), start)
        base = fit(chain, (), base.point)  # an effect must not gain by what the base has not reached
    chain, base = with_usual_start(chain, base)
    return Search(chain, base, base, identified_base(chain, start, given))


def _with_changes(begun: Search) -> Search:
    """State with every change of the given model that is worth it, the best first."""
    state: Search | None = begun
    while state is not None:
        begun, state = state, _with_best_change(state)
    return begun


def _with_refined_base(state: Search) -> Search:
    """State in which the base may be refined, before a new effect is named for its sake.

    A change of the stack keeps its factors: they were estimated with the base of the given model.
    """
    chain = with_loose_base(state.chain) if state.has_known else state.chain
    if chain is state.chain:
        return state
    hypothesis = state.hypothesis
    stack = (state.chain, hypothesis) if state.stack_changed else None
    terms = tuple(replace(term, held=term.held or term.effect.name in NAMES) for term in hypothesis.terms)
    return state.on_chain(chain, fit(chain, terms, hypothesis.point), stack=stack)


def _with_best_change(state: Search) -> Search | None:
    """State with the best change of a given effect or of the stack; None where no change is worth it.

    A change is likelier than a new effect, so it is tried first. It must leave no more than noise, or little beside
    what the best new effect leaves. Without given effects and tones a change of the stack must leave nearly nothing,
    because a new effect may do the same.
    """
    chain, hypothesis = state.chain, state.hypothesis
    names = [term.effect.name for term in hypothesis.terms if term.held]
    tried = [(chain, with_fitted_values(chain, hypothesis, name, state.past)) for name in names]
    limit = highest_accepted_loss(hypothesis) if state.has_known else RULES.stack_alone * hypothesis.loss
    stack = None if state.stack_changed else with_stack_changed(chain, hypothesis, state.past, limit)
    if stack is not None and stack[1].loss < limit:
        tried.append(stack)
    best = min(tried, key=lambda pair: pair[1].loss, default=None)
    if best is None or not worth(hypothesis, best[1]):
        return None
    if hypothesis.loss - best[1].loss < state.least_gain:
        return None
    if best[1].loss > RULES.at_noise and _new_effect_leaves_less(state, RULES.known_first * best[1].loss):
        return None
    return state.on_chain(*best)


def _new_effect_leaves_less(state: Search, loss: float) -> bool:
    best = Candidates(state).best
    return best is not None and best[1].loss < loss


def _is_unchanged(state: Search) -> bool:
    """Whether neither a change of the given model nor a further effect or tone could be accepted.

    Every candidate is estimated from one linear step at the given model, none is fitted. If no estimate comes near the
    least gain that the search accepts, the search would find nothing, and is not begun. A model that leaves more than
    noise is searched in any case: then pairs, corners and laws without a name count too.
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
