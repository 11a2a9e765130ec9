"""The search: grow a hypothesis by the effect that explains most of what is left, then try to swap and to drop."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.chain import Chain, Point, Scope, Term
from piezod.diagnose.direct import edges_of_step, lines
from piezod.diagnose.fit import Fitted, Normal, fit
from piezod.diagnose.ideas import Idea, screened
from piezod.effects import EFFECTS
from piezod.effects.effect import HELD, HELD_BEFORE, STRAIGHT

Array = NDArray[np.float64]
OnProgress = Callable[[str], None]

MOST_EFFECTS = 5
TRIED = 6  # effects that are really fitted in a round
PROMISING = 0.1  # of the best idea's gain, below which an idea is not tried
WORTH = 0.04  # of the loss that is left: what an effect must gain at least
FAIR_SHARE = 0.02  # of the largest gain so far: more effects than that are the plant's own shape
MAINS_HZ = (50.0, 60.0)


@dataclass(frozen=True)
class Round:
    """One effect that was accepted, and what else was tried."""

    before: Fitted
    accepted: Fitted
    others: tuple[Fitted, ...]


@dataclass
class Search:
    """What was found and on which way.

    Parameters
    ----------
    chain
        Recordings, with the course between samples that fits best.
    base
        Nothing but the base.
    found
        The hypothesis at the end.
    rounds
        In the order of the search.
    """

    chain: Chain
    base: Fitted
    found: Fitted
    rounds: list[Round] = field(default_factory=list)


def search(chain: Chain, start: Point, progress: OnProgress) -> Search:
    """Find the effects that the recordings show.

    Parameters
    ----------
    chain
        Recordings and base.
    start
        Of the base.
    progress
        Told what is being done.
    """
    progress("fitting the base")
    chain, base = _best_course(chain, (), start)
    result = Search(chain, base, base)
    largest = 0.0
    while len(result.found.terms) < MOST_EFFECTS:
        progress(f"looking for effect {len(result.found.terms) + 1}")
        tried = _tried(result.chain, result.found)
        better = [one for one in tried if worth(result.found, one, largest)]
        if not better:
            break
        best = min(better, key=lambda one: one.loss)
        before = result.found
        result.chain, best = _best_course(result.chain, best.terms, best.point, best)
        largest = max(largest, before.loss - best.loss)
        others = tuple(one for one in tried if one.terms[-1].effect is not best.terms[-1].effect)
        result.rounds.append(Round(before, best, others))
        result.found = best
    progress("trying to swap and to drop")
    _swap(result)
    _drop(result, largest)
    return result


def worth(before: Fitted, after: Fitted, largest: float) -> bool:
    """Whether an effect gains enough on blocks left out, and in most of them."""
    gain = before.loss - after.loss
    if gain < max(WORTH * after.loss, FAIR_SHARE * largest):
        return False
    if after.terms[-1].scope == "once":
        return True
    gains = np.log(before.losses / after.losses)
    touched = gains[np.abs(gains) > 1e-3]
    if touched.size < 4:
        return False
    weights = np.abs(touched)
    return float(np.sum(touched)) > 2.5 * float(np.sqrt(np.sum(weights**2)))


def _best_course(
    chain: Chain, terms: Sequence[Term], point: Point, known: Fitted | None = None
) -> tuple[Chain, Fitted]:
    """The course of the command between samples under which a hypothesis fits best."""
    results = []
    for between in (STRAIGHT, HELD, HELD_BEFORE):
        if known is not None and chain.series[0].between == between:
            results.append((chain, known))
            continue
        other = Chain(
            [replace(one, between=between) for one in chain.series], chain.density, chain.law, chain.force_span_N
        )
        results.append((other, fit(other, terms, point)))
    return min(results, key=lambda one: one[1].loss)


def _tried(chain: Chain, found: Fitted) -> list[Fitted]:
    """Hypotheses with one more effect, really fitted."""
    ideas = screened(chain, found.terms, found.point)
    chosen: dict[str, list[Idea]] = {}
    for idea in ideas:
        if idea.gain >= PROMISING * ideas[0].gain and (len(chosen) < TRIED or idea.term.effect.name in chosen):
            chosen.setdefault(idea.term.effect.name, []).append(idea)
    results = [_fitted_best(chain, found, some) for some in chosen.values()]
    results += [_extended(chain, found, idea) for idea in suggested(chain, found)]
    return [one for one in results if one is not None]


def _fitted_best(chain: Chain, found: Fitted, ideas: Sequence[Idea]) -> Fitted:
    """The best fit of one effect: its two best starts, both scopes, every choice."""
    starts = [ideas[0], *[one for one in ideas[1:] if one.values != ideas[0].values][:1]]
    best = min((_extended(chain, found, idea) for idea in starts), key=lambda one: one.loss)
    for scope in ("since", "already"):
        if scope != best.terms[-1].scope:
            best = min(best, _again(chain, best, scope=scope), key=lambda one: one.loss)
    for parameter in best.terms[-1].effect.parameters:
        for choice in parameter.choices:
            if (parameter.name, choice) not in best.terms[-1].choices:
                best = min(best, _again(chain, best, choice=(parameter.name, choice)), key=lambda one: one.loss)
    return best


def _extended(chain: Chain, found: Fitted, idea: Idea) -> Fitted:
    point = found.point
    return fit(chain, (*found.terms, idea.term), replace(point, values=(*point.values, idea.values)))


def _again(
    chain: Chain, fitted: Fitted, *, scope: Scope | None = None, choice: tuple[str, float] | None = None
) -> Fitted:
    """The same hypothesis with another scope or choice of its last effect."""
    last = fitted.terms[-1]
    if scope is not None:
        last = replace(last, scope=scope)
    if choice is not None:
        last = replace(last, choices=tuple(choice if one[0] == choice[0] else one for one in last.choices))
    return fit(chain, (*fitted.terms[:-1], last), fitted.point, most_steps=8)


def suggested(chain: Chain, found: Fitted) -> list[Idea]:
    """What the direct tests say of the residuals."""
    normal = Normal.at(chain, found.terms, found.point)
    ideas = []
    for number, series in enumerate(chain.series):
        if series.role == "identification":
            continue
        residual_N = series.reading_N - normal.readings[number]
        for line in lines(series, residual_N)[:2]:
            near = min(MAINS_HZ, key=lambda mains: abs(line.frequency_Hz - mains))
            name = "mains_hum" if abs(line.frequency_Hz - near) < 0.6 else "vibration"
            ideas.append(
                _idea(
                    name,
                    number,
                    {"amplitude_N": line.amplitude_N, "frequency_Hz": line.frequency_Hz, "phase_rad": line.phase_rad},
                )
            )
        step = edges_of_step(series, residual_N)
        if step is not None:
            height_N, first, end = step
            places = {"step_N": height_N, "on_s": first * series.dt_s, "off_s": end * series.dt_s}
            ideas.append(_idea("load_step", number, places))
    return [idea for idea in ideas if not any(term.effect is idea.term.effect for term in found.terms)]


def _idea(name: str, number: int, known: dict[str, float]) -> Idea:
    effect = EFFECTS[name]
    values = {one.name: one.starts[0] for one in effect.parameters if not one.choices}
    choices = tuple((one.name, one.choices[0]) for one in effect.parameters if one.choices)
    values.update(
        {
            key: float(np.clip(value, effect.parameter(key).low, effect.parameter(key).high))
            for key, value in known.items()
        }
    )
    return Idea(Term(effect, "once", number, choices), values)


def _swap(result: Search) -> None:
    """Put a rival in an effect's place where the whole fits better with it."""
    for place in range(len(result.found.terms)):
        name = result.found.terms[place].effect.name
        rivals = [
            one
            for round_ in result.rounds
            if round_.accepted.terms and round_.accepted.terms[-1].effect.name == name
            for one in round_.others
        ]
        for rival in sorted(rivals, key=lambda one: one.loss)[:2]:
            term, values = rival.terms[-1], rival.point.values[-1]
            if any(term.effect is other.effect for other in result.found.terms) or len(result.found.terms) == 1:
                continue
            terms, all_values = list(result.found.terms), list(result.found.point.values)
            terms[place], all_values[place] = term, values
            swapped = fit(result.chain, terms, replace(result.found.point, values=tuple(all_values)))
            if swapped.loss < 0.98 * result.found.loss:
                result.found = swapped


def _drop(result: Search, largest: float) -> None:
    """Leave out effects that the others have made needless."""
    place = 0
    while place < len(result.found.terms) and len(result.found.terms) > 1:
        found = result.found
        terms = [*found.terms[:place], *found.terms[place + 1 :]]
        values = [*found.point.values[:place], *found.point.values[place + 1 :]]
        without = fit(result.chain, terms, replace(found.point, values=tuple(values)))
        if without.loss - found.loss < max(WORTH * found.loss, FAIR_SHARE * largest):
            result.found = without
            place = 0
        else:
            place += 1


__all__ = ["Round", "Search", "search", "suggested", "worth"]
