"""The search: grow a hypothesis by the effect that explains most of what is left, then try to swap and to drop."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.candidates.screening import catalogue_ideas
from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.sampling import best_course, coarse, settled, started_as_usual, suited_anew
from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.hypothesis.stack_change import NAMES, with_stack_changed
from piezod.diagnose.selection.acceptance import (
    BETTER,
    counted,
    degenerate,
    steady_enough,
    weighed,
    worth,
)
from piezod.diagnose.selection.corners import sharpened
from piezod.diagnose.selection.given_effects import freed, settle
from piezod.diagnose.selection.replay import Attempt
from piezod.diagnose.selection.search_state import Beside, Round, Search
from piezod.diagnose.selection.tone_search import dominates, heard, listen, listen_again
from piezod.diagnose.selection.trials import on_each_course, two_at_once, with_a_step
from piezod.effects import EFFECTS

Array = NDArray[np.float64]
OnProgress = Callable[[str, float], None]

MOST_EFFECTS = 5
SEARCHED, FURTHER = 0.85, 0.5  # part of the work behind the search; of what is before it, left after a round
FINALISTS = 3  # of them that are tried with every course of the command between samples
BESIDE_A_STEP = 2  # effects that a step was preferred to are tried with a step of their own
SEVERAL, STARTS_ANEW = 3, 2  # parameters of an effect that is begun anew beside a new one, and its starts
PAIRS_SETTLED = 2  # of effects, that are tried with every course of the command between samples
NOTHING_LEFT = 1.05  # of the noise's square: nothing is looked for beside what leaves no more
NEARLY_ALL = 0.05  # of the loss: a change of the stack that leaves no more is taken before any effect is tried
RIVALS = 6  # of an effect, that are tried in its place at the end
DOUBTED = 3  # of those that fit better and are not believed that are fitted from other starts


def search(chain: Chain, start: Point, progress: OnProgress, given: tuple[Term, ...] = ()) -> Search:
    """Find the effects that the recordings show.

    Parameters
    ----------
    chain
        Recordings and base.
    start
        Of the base, with the values of the given effects.
    progress
        Told what is being done, and what part of the work is behind it at least.
    given
        Effects of the given model, held at their values.
    """
    progress("fitting the base", 0.02)
    result = _begun(chain, start, given)
    while len(result.new) < MOST_EFFECTS:
        progress(f"looking for effect {len(result.new) + 1}", SEARCHED - (SEARCHED - 0.1) * FURTHER ** len(result.new))
        tone = heard(result)
        if tone is not None and dominates(result, tone):
            listen(result, tone)
            continue
        tried = on_each_course(result.chain, result.found, result.past) + _beside_the_last_step(result)
        finalists = _finalists(result, tried)
        best = min(finalists, key=lambda one: weighed(one[1]), default=None)
        if tone is not None and (best is None or tone[1].loss < best[1].loss):
            listen(result, tone)
            continue
        sharp = _sharper(result, best)
        if sharp is not None:
            _sharpen(result, *sharp)
            continue
        if _with_another_stack(result, best):
            continue
        if best is None:
            if not both(result, tried):
                break
            _follow(result)
            continue
        before = _without_it(result, best)
        if before is not result.found:  # some of the gain is the other course's or the other starts'
            result.base = fit(best[0], result.base.terms, result.base.point)
            if not worth(before, best[1]):
                result.chain, result.found = best[0], before
                continue
        result.chain, result.found = best
        others = tuple(
            one for on, one in tried if one.effects[-1] != result.found.effects[-1] and not degenerate(on, one)
        )
        result.rounds.append(Round(before, result.found, others))
        begin_anew(result)
        _follow(result)
    progress("trying to swap and to drop", SEARCHED)
    swap(result)
    result.found, result.statuses = settle(result.chain, result.found, result.base)
    _drop(result)
    _polish(result)
    return result


def _begun(chain: Chain, start: Point, given: tuple[Term, ...]) -> Search:
    """The search before its first round: how the command runs and what led to the starts, and what has changed.

    A model with effects states how the command runs; it is found anew with the effects.
    """
    if given:
        base = fit(chain, given, start)
    else:
        chain, base = best_course(chain, (), start)
        base = fit(chain, (), base.point)  # a base that has not arrived would take any effect for its own way
    chain, base = started_as_usual(chain, base)
    result = Search(chain, base, base, _past(chain, start, given))
    while _changed(result):
        pass
    return result


def _changed(result: Search) -> bool:
    """One more change of what is known, the one that leaves least: of a given effect's values, or of the stack.

    It is looked for before new effects, since it is likelier. Where no effect is given, another stack must explain
    nearly all: a new effect may do the same.
    """
    names = [term.effect.name for term in result.found.terms if term.held]
    tried = [freed(result.chain, result.found, name, result.past) for name in names]
    stack = None if result.stack_changed else with_stack_changed(result.chain, result.found, result.past)
    if stack is not None and (names or stack.loss < NEARLY_ALL * result.found.loss):
        tried.append(stack)
    best = min(tried, key=lambda one: one.loss, default=result.found)
    if best is result.found or not worth(result.found, best):
        return False
    result.found = best
    return True


def _with_another_stack(result: Search, best: tuple[Chain, Fitted] | None) -> bool:
    """Another gain and other loops of the stack since the identification, where no effect explains as much."""
    if result.stack_changed or result.found.loss <= NOTHING_LEFT:
        return False
    other = with_stack_changed(result.chain, result.found, result.past)
    if not worth(result.found, other) or (best is not None and BETTER * other.loss > best[1].loss):
        return False
    result.found = other
    return True


def _follow(result: Search) -> None:
    """Follow the tones anew beside what was found, if there are any."""
    if result.tones:
        listen_again(result)


def _finalists(result: Search, tried: list[tuple[Chain, Fitted]]) -> list[tuple[Chain, Fitted]]:
    """The best of those that are believed, each with the course and the starts that suit it best.

    What fits better than they do may not be believed because its start or its course was estimated without it. It is
    tried with both estimated anew. On another course or from other starts it is compared with what was found so far on
    these: a start that was estimated without it may say most of what it does.
    """
    before = {id(result.chain): result.found}
    for on, _ in tried:
        if id(on) not in before:
            before[id(on)] = fit(on, result.found.terms, result.found.point, most_steps=6)

    def believed(one: tuple[Chain, Fitted]) -> bool:
        on, after = one
        return after.loss < BETTER * result.found.loss and _believed(on, before.get(id(on), result.found), after)

    tried = sorted(tried, key=lambda one: one[1].loss)
    better = []
    for on, after in tried:
        kept = believed((on, after))
        better += [(on, after)] * kept
        result.attempts.append(
            Attempt("one", len(result.names), before[id(on)], after, degenerate=degenerate(on, after), believed=kept)
        )
    limit = better[0][1].loss if better else result.found.loss
    doubted = [one for one in tried if one[1].loss < limit and not degenerate(*one)][:DOUBTED]
    anew = [one for one in each(suited_anew, doubted) if one is not None and believed(one)]
    return each(settled, sorted(better + anew, key=lambda one: one[1].loss)[:FINALISTS])


def _believed(chain: Chain, before: Fitted, after: Fitted) -> bool:
    """Whether one more effect is what its name says, and gains enough."""
    return not degenerate(chain, after) and worth(before, after) and steady_enough(before, after)


def both(result: Search, tried: Sequence[tuple[Chain, Fitted]]) -> bool:
    """Two effects at once of which none is believed alone, since each leaves what the other one is; if they are found.

    Each must be believed beside the other, and one of them have a shape that does not bend to what is left.
    """
    if len(result.new) + 2 > MOST_EFFECTS or result.found.loss <= NOTHING_LEFT:
        return False
    pairs = [one for one in two_at_once(result.chain, result.found) if worth(result.found, one)]
    believed = []
    for chain, pair in each(settled, [(result.chain, pair) for pair in sorted(pairs, key=weighed)[:PAIRS_SETTLED]]):
        orders = pair, _turned(pair)
        firsts = [fit(chain, one.terms[:-1], replace(one.point, values=one.point.values[:-1])) for one in orders]
        beside = zip(firsts, orders, strict=True)
        kept = worth(result.found, pair) and all(_believed(chain, *one) for one in beside)
        believed += [(chain, firsts[0], pair)] * kept
        unlike = any(degenerate(chain, one) for one in orders)
        result.attempts.append(Attempt("pair", len(result.names), result.found, pair, degenerate=unlike, believed=kept))
    if not believed:
        return False
    chain, first, pair = min(believed, key=lambda one: weighed(one[2]))
    alone = [one for on, one in tried if on is result.chain and worth(result.found, one) and not degenerate(on, one)]
    others = tuple(one for one in alone if one.effects[-1] not in pair.effects)
    result.rounds += [Round(result.found, first, others), Round(first, pair, ())]
    if chain is not result.chain:
        result.chain, result.base = chain, fit(chain, result.base.terms, result.base.point)
    result.found = pair
    return True


def _turned(pair: Fitted) -> Fitted:
    """The same with the last two effects the other way round."""
    order = [*range(len(pair.terms) - 2), len(pair.terms) - 1, len(pair.terms) - 2]
    point = replace(pair.point, values=tuple(pair.point.values[k] for k in order))
    return replace(
        pair,
        terms=tuple(pair.terms[k] for k in order),
        point=point,
        spread=tuple(pair.spread[k] for k in order),
    )


def _sharper(result: Search, best: tuple[Chain, Fitted] | None) -> tuple[Chain, Fitted] | None:
    """The same with corners in the base, where these take more off than any effect: a name would be for their sake.

    By all recordings only where no effect is left that may bend them.
    """
    enough = min(BETTER * result.found.loss, np.inf if best is None else best[1].loss)
    for by_all in (False, True) if best is None else (False,):
        sharp = sharpened(result.chain, result.found, by_all=by_all)
        if sharp is not None and sharp[1].loss < enough:
            return sharp
    return None


def _sharpen(result: Search, chain: Chain, found: Fitted) -> None:
    """Go on with plays of their own width in the base."""
    result.chain, result.found = chain, found
    result.fit_base()
    result.past = _past(chain, result.base.point, result.base.terms)


def _beside_the_last_step(result: Search) -> list[tuple[Chain, Fitted]]:
    """Where a step of the load was found last: what came next to it, each with a step that suits it."""
    if not result.rounds or result.found.effects[-1:] != ("load_step",):
        return []
    if not result.rounds[-1].accepted.point.alike(result.found.point):
        return []  # fitted before the base had sharp plays
    others = sorted(result.rounds[-1].others, key=lambda one: one.loss)
    return with_a_step(result.chain, result.found, others[:BESIDE_A_STEP])


def _without_it(result: Search, best: tuple[Chain, Fitted]) -> Fitted:
    """What was found so far: on the course and from the starts that came with one more effect, if it fits better."""
    if best[0] is result.chain:
        return result.found
    alone = fit(best[0], result.found.terms, result.found.point)
    return alone if alone.loss < BETTER * result.found.loss else result.found


def begin_anew(result: Search) -> None:
    """Fit effects found before anew beside the last one: in the other scope, with another choice, from another start.

    What was fitted without the last effect may have taken on its shape, and stays there.

    Parameters
    ----------
    result
        Search; its hypothesis is replaced where another one leaves less.
    """
    few, found = coarse(result.chain), result.found
    known = fit(few, found.terms, found.point, most_steps=2)
    others = []
    for place, term in enumerate(found.terms[:-1]):
        if term.effect.name in (*result.given, *NAMES):
            continue
        values = found.point.values[place]
        anew = [(replace(term, choices=choices), values) for choices in _other_choices(term)]
        if term.scope != "once":
            anew.append((replace(term, scope="since" if term.scope == "already" else "already"), values))
        anew += [(other, start) for other in (term, *(one for one, _ in anew)) for start in _starts(few, term)]
        others += [_exchanged(found, place, *one) for one in anew]
    tried = each(lambda one: fit(few, *one, most_steps=6), others)
    best = min(tried, key=lambda one: one.loss, default=known)
    if best.loss < BETTER * known.loss:
        result.found = fit(result.chain, best.terms, best.point)


def _exchanged(found: Fitted, place: int, term: Term, values: Mapping[str, float]) -> tuple[tuple[Term, ...], Point]:
    """A hypothesis with one effect in another form or from another start."""
    terms = (*found.terms[:place], term, *found.terms[place + 1 :])
    point = replace(found.point, values=(*found.point.values[:place], values, *found.point.values[place + 1 :]))
    return terms, point


def _starts(chain: Chain, term: Term) -> list[dict[str, float]]:
    """Where a search for an effect of several parameters may begin: of these, one can stand in for another."""
    if term.scope == "once" or len(term.searched) < SEVERAL:
        return []
    ideas = [values for effect, values, choices in catalogue_ideas(chain, [], {}) if effect is term.effect]
    return ideas[:STARTS_ANEW]


def _other_choices(term: Term) -> list[tuple[tuple[str, float], ...]]:
    """The choices of an effect with one of them changed."""
    return [
        tuple((name, value) if name == parameter.name else (name, chosen) for name, chosen in term.choices)
        for parameter in term.effect.parameters
        for value in parameter.search.choices
        if (parameter.name, value) not in term.choices
    ]


def _polish(result: Search) -> None:
    """Base and hypothesis once more on all samples."""
    result.chain = result.chain.like(result.chain.series, max(map(_length, result.chain.series)))
    result.found = fit(result.chain, result.found.terms, result.found.point)
    result.base = fit(result.chain, result.base.terms, result.base.point, most_steps=4)


def _length(series: Series) -> int:
    return int(series.time_s.size)


def _past(chain: Chain, start: Point, given: tuple[Term, ...]) -> Point:
    """The base fitted to the recordings of the identification alone, the others shifted onto it."""
    known = [k for k, one in enumerate(chain.series) if one.role == "identification"]
    alone = chain.like([chain.series[k] for k in known])
    point = fit(alone, given, start.of(known)).point
    offsets_N, starts = np.zeros(len(chain.series)), list(start.starts)
    offsets_N[known] = point.offsets_N
    for k, one in zip(known, point.starts, strict=True):
        starts[k] = one
    return replace(point, offsets_N=offsets_N, starts=tuple(starts))


def swap(result: Search) -> None:
    """Put a rival in an effect's place where the whole fits better with it, beside all that was found since."""
    if len(result.found.effects) == 1 and not EFFECTS[result.found.effects[0]].general:
        return
    for name in [one for one in result.found.effects if one not in result.given]:
        rivals = _rivals(result, name)
        if not rivals:
            continue
        fewer = fitted_without(result.chain, result.found, name)
        few = coarse(result.chain)
        tried = each(partial(_with_instead, few, result.found, name, most_steps=4), rivals)
        few.forget()
        best = sorted(tried, key=lambda one: one.loss)[:2]
        swapped = each(partial(_with_instead, result.chain, result.found, name), best)
        fitting = [one for one in swapped if worth(fewer, one) and not degenerate(result.chain, one)]
        losses = {name: counted(name, fewer.loss, result.found.loss)} | {one.effects[-1]: np.inf for one in swapped}
        losses |= {one.effects[-1]: counted(one.effects[-1], fewer.loss, one.loss) for one in fitting}
        taken = min(losses, key=lambda one: losses[one])
        if losses[taken] < BETTER * losses[name]:
            result.found = next(one for one in fitting if one.effects[-1] == taken)
        else:
            taken = name
        result.beside[taken] = Beside(fewer.loss, losses.pop(taken), losses)


def instead(result: Search, name: str) -> list[Fitted]:
    """The hypothesis with each rival that is what its name says in an effect's place, fitted anew."""
    fitted = each(partial(_with_instead, result.chain, result.found, name), _rivals(result, name))
    return [one for one in fitted if not degenerate(result.chain, one)]


def _rivals(result: Search, name: str) -> list[Fitted]:
    """What was tried when an effect was accepted and was not found since, the best with each effect."""
    tried = [one for round_ in result.rounds if round_.accepted.effects[-1] == name for one in round_.others]
    return _first_of_each([one for one in tried if one.effects[-1] not in result.found.effects])[:RIVALS]


def _first_of_each(tried: Sequence[Fitted]) -> list[Fitted]:
    """The best with each last effect, the best one first."""
    best: dict[str, Fitted] = {}
    for one in sorted(tried, key=lambda one: one.loss):
        best.setdefault(one.effects[-1], one)
    return list(best.values())


def _with_instead(chain: Chain, found: Fitted, name: str, rival: Fitted, most_steps: int = MOST_STEPS) -> Fitted:
    terms, values = without(found, name)
    last = [k for k, term in enumerate(rival.terms) if term.effect.name == rival.effects[-1]]
    terms += [rival.terms[k] for k in last]
    values += [rival.point.values[k] for k in last]
    return fit(chain, terms, replace(found.point, values=tuple(values)), most_steps=most_steps)


def fitted_without(chain: Chain, found: Fitted, name: str) -> Fitted:
    """The hypothesis without an effect, fitted anew."""
    terms, values = without(found, name)
    return fit(chain, terms, replace(found.point, values=tuple(values)))


def without(found: Fitted, name: str) -> tuple[list[Term], list[Mapping[str, float]]]:
    """Terms of all other effects, and their values."""
    kept = [k for k, term in enumerate(found.terms) if term.effect.name != name]
    return [found.terms[k] for k in kept], [found.point.values[k] for k in kept]


def _drop(result: Search) -> None:
    """Leave out effects that the others, or the base as it is at the end, have made needless."""
    left = [name for name in result.found.effects if name not in result.given]
    while left:
        fewer = fitted_without(result.chain, result.found, left.pop(0))
        needed = worth(fewer, result.found)
        result.attempts.append(
            Attempt("drop", len(result.names), fewer, result.found, degenerate=False, believed=needed)
        )
        if not needed:
            result.found = fewer
            left = [name for name in fewer.effects if name not in result.given]
