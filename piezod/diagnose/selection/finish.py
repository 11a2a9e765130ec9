"""The end of a search: effects are exchanged for rivals or left out, and all samples are fitted."""

from dataclasses import replace
from functools import partial

import numpy as np

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import FINE_STEPS, coarse
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.acceptance import comparison_loss, degenerate, worth
from piezod.diagnose.selection.candidates import first_of_each
from piezod.diagnose.selection.given_effects import refitted_without, without
from piezod.diagnose.selection.replay import Attempt
from piezod.diagnose.selection.search_state import Rivalry, Search
from piezod.effects import EFFECTS

RIVALS = 6  # rivals of an effect that are tried in its place
THOROUGH = 2  # of them that are fitted on all compared samples


def replace_by_rivals(state: Search) -> Search:
    """State with a rival in an effect's place where the whole hypothesis fits better with it."""
    if len(state.hypothesis.effects) == 1 and not EFFECTS[state.hypothesis.effects[0]].general:
        return state
    for name in [effect for effect in state.hypothesis.effects if effect not in state.given]:
        rivals = _rivals(state, name)
        if rivals:
            state = _with_best_rival(state, name, rivals)
    return state


def _with_best_rival(state: Search, name: str, rivals: list[Fitted]) -> Search:
    """State with the best of an effect and its rivals, and with their comparison."""
    without_it = refitted_without(state.chain, state.hypothesis, name)
    few = coarse(state.chain)
    tried = each(partial(_with_rival, few, state.hypothesis, name, most_steps=4), rivals)
    few.forget()
    best = sorted(tried, key=lambda fitted: fitted.loss)[:THOROUGH]
    swapped = each(lambda rival: fit(state.chain, rival.terms, rival.point, most_steps=FINE_STEPS), best)
    fitting = [fitted for fitted in swapped if worth(without_it, fitted) and not degenerate(state.chain, fitted)]
    losses = {name: comparison_loss(name, without_it.loss, state.hypothesis.loss)}
    losses |= {fitted.effects[-1]: np.inf for fitted in swapped}
    losses |= {
        fitted.effects[-1]: comparison_loss(fitted.effects[-1], without_it.loss, fitted.loss) for fitted in fitting
    }
    taken = min(losses, key=lambda effect: losses[effect])
    hypothesis = state.hypothesis
    if losses[taken] < RULES.better * losses[name]:
        hypothesis = next(fitted for fitted in fitting if fitted.effects[-1] == taken)
    else:
        taken = name
    rivalry = Rivalry(without_it.loss, losses.pop(taken), losses)
    return replace(state, hypothesis=hypothesis, rivalries={**state.rivalries, taken: rivalry})


def with_each_rival(state: Search, name: str) -> list[Fitted]:
    """Hypotheses with each plausible rival in an effect's place."""
    fitted = each(partial(_with_rival, state.chain, state.hypothesis, name), _rivals(state, name))
    return [rival for rival in fitted if not degenerate(state.chain, rival)]


def _rivals(state: Search, name: str) -> list[Fitted]:
    """Hypotheses that were tried when an effect was accepted, the best with each effect that is not in use."""
    tried = [
        other
        for round_ in state.rounds
        for other in round_.others
        if round_.accepted.effects[-1] == name and other.loss < RULES.far_behind * round_.accepted.loss
    ]
    return first_of_each([other for other in tried if other.effects[-1] not in state.hypothesis.effects])[:RIVALS]


def _with_rival(chain: Chain, fitted: Fitted, name: str, rival: Fitted, most_steps: int = MOST_STEPS) -> Fitted:
    """Hypothesis with the last effect of `rival` in the place of an effect."""
    terms, values = without(fitted, name)
    last = [k for k, term in enumerate(rival.terms) if term.effect.name == rival.effects[-1]]
    terms += [rival.terms[k] for k in last]
    values += [rival.point.values[k] for k in last]
    return fit(chain, terms, replace(fitted.point, values=tuple(values)), most_steps=most_steps)


def remove_redundant(state: Search) -> Search:
    """State without the effects that the others, or the final base, make unnecessary.

    Where the given model predicts the recordings, a small gain comes from the errors of its values.
    """
    waiting = [name for name in state.hypothesis.effects if name not in state.given]
    attempts = list(state.attempts)
    while waiting:
        fewer = refitted_without(state.chain, state.hypothesis, waiting.pop(0))
        required = worth(fewer, state.hypothesis) and fewer.loss - state.hypothesis.loss >= state.least_gain
        attempts.append(Attempt("drop", len(state.names), fewer, state.hypothesis, degenerate=False, accepted=required))
        if not required:
            state = replace(state, hypothesis=fewer)
            waiting = [name for name in fewer.effects if name not in state.given]
    return replace(state, attempts=tuple(attempts))


def fit_all_samples(state: Search) -> Search:
    """State with base and hypothesis fitted to all samples."""
    chain = state.chain.like(state.chain.series, max(series.time_s.size for series in state.chain.series))
    fitted = fit(chain, state.hypothesis.terms, state.hypothesis.point)
    is_base = state.hypothesis is state.base
    base = fitted if is_base else fit(chain, state.base.terms, state.base.point, most_steps=4)
    return replace(state, chain=chain, hypothesis=fitted, base=base)
