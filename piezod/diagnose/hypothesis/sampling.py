"""How the command runs between samples, and what led to the start of a recording: settled for each hypothesis."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.chain import Chain, Point, Term
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.estimation.initial_state import CLEARLY, start_at_zero, starts_at_rest
from piezod.recording.hold import HELD_BEFORE, STRAIGHT, Hold

Array = NDArray[np.float64]

HELD_PARTS = (0.3, 0.7)  # of a sample after its command, where the search for the moment of reading begins
SMALLEST_PART = 0.04
START_LOOKED_AT_S = 20.0
SAME = 0.005  # of the loss
COARSE_ROWS = 6000  # samples of a recording that are compared while much is tried


def settled(one: tuple[Chain, Fitted]) -> tuple[Chain, Fitted]:
    """A hypothesis with the course and the starts that suit it best."""
    return _suited(*one, courses=True) or one


def suited_anew(one: tuple[Chain, Fitted]) -> tuple[Chain, Fitted] | None:
    """A hypothesis with the starts that suit it, and the course if its last effect smooths; None where it has them."""
    return _suited(*one, courses=one[1].terms[-1].effect.smooths)


def _suited(chain: Chain, fitted: Fitted, *, courses: bool) -> tuple[Chain, Fitted] | None:
    few = coarse(chain)
    known = fit(few, fitted.terms, fitted.point, most_steps=2)
    course = best_course(few, fitted.terms, fitted.point, known) if courses else (few, known)
    best, again = started_as_usual(*restarted(*course))
    if again is known:
        return None
    fine = chain.like(best.series)
    return fine, fit(fine, again.terms, again.point, most_steps=6)


def started_alike(chain: Chain) -> Chain | None:
    """The same with recordings that start at rest started as the first of the identification; None where they are."""
    resting = _resting(chain)
    return _started(chain, chain.series[resting[0]].path_V) if resting else None


def started_as_usual(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """The same with starts as in the identification, or virgin ones, where the hypothesis, fitted anew, fits better.

    A start that was estimated without an effect has bent the effect's parameters, and with these no other start fits.
    """
    best = chain, fitted
    for other in (started_alike(chain), _started(chain, ())):
        if other is not None:
            again = fit(other, fitted.terms, fitted.point)
            best = min(best, (other, again), key=lambda one: one[1].loss)
    return best


def _started(chain: Chain, path_V: tuple[float, ...]) -> Chain | None:
    """The same with all recordings that start at rest started like this; None where they are."""
    resting = _resting(chain)
    if all(chain.series[k].path_V == path_V for k in resting):
        return None
    return chain.like([replace(one, path_V=path_V) if k in resting else one for k, one in enumerate(chain.series)])


def _resting(chain: Chain) -> list[int]:
    return [k for k, one in enumerate(chain.series) if starts_at_rest(one.command_V)]


def restarted(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """The same with what led to each start estimated anew: under the given model an effect may have passed for it."""
    series, resting = list(chain.series), _resting(chain)
    for number in resting:
        one = chain.series[number]
        loss = partial(_loss_of_start, chain, fitted, number)
        path = start_at_zero(one.command_V, "V", loss).path
        usual = series[resting[0]].path_V  # a bench that is not used between its recordings starts them alike
        if loss(path) >= CLEARLY * loss(usual):
            path = usual
        if loss(path) < (1.0 if path == usual else CLEARLY) * loss(one.path_V):
            series[number] = replace(one, path_V=path)
    if all(new is old for new, old in zip(series, chain.series, strict=True)):
        return chain, fitted
    other = chain.like(series)
    again = fit(other, fitted.terms, fitted.point)
    return (other, again) if again.loss < fitted.loss else (chain, fitted)


def _loss_of_start(chain: Chain, fitted: Fitted, number: int, path_V: tuple[float, ...]) -> float:
    series = list(chain.series)
    series[number] = replace(series[number], path_V=path_V)
    one = series[number]
    error = one.reading_N - chain.like(series).run(number, fitted.terms, fitted.point).reading_N
    window = slice(0, int(START_LOOKED_AT_S / one.dt_s))
    return float(np.mean(np.square(error[window][one.counts[window]])))


def best_course(chain: Chain, terms: Sequence[Term], point: Point, known: Fitted | None = None) -> tuple[Chain, Fitted]:
    """The course of the command between samples under which a hypothesis fits best.

    Held commands differ from each other only where something smooths them.
    """
    smooth = any(term.effect.smooths for term in terms)
    results: dict[Hold, tuple[Chain, Fitted]] = {}
    if known is not None:
        results[chain.series[0].hold] = (chain, known)

    def best() -> Hold:
        found = min(results, key=lambda hold: results[hold][1].loss)
        straight = results.get(STRAIGHT)
        if straight is not None and straight[1].loss <= (1.0 + SAME) * results[found][1].loss:
            return STRAIGHT  # a held command read late and a delay are the same
        return found

    def judged(hold: Hold) -> None:
        if hold not in results:
            series = [replace(one, hold=hold) for one in chain.series]
            other = chain.like(series)
            results[hold] = (other, fit(other, terms, point, most_steps=MOST_STEPS if known is None else 6))
            other.forget()

    for hold in (STRAIGHT, *(Hold("held", part) for part in HELD_PARTS if smooth), HELD_BEFORE):
        judged(hold)
    width = 0.5 * (HELD_PARTS[1] - HELD_PARTS[0])
    while best().sampling == "held" and width > SMALLEST_PART:
        middle = best().read_after
        for read_after in (middle - width, middle + width):
            if 0.0 < read_after <= 1.0:
                judged(Hold("held", read_after))
        width *= 0.5
    return results[best()]


def coarse(chain: Chain) -> Chain:
    """The same, few samples of it compared."""
    return chain.like(chain.series, COARSE_ROWS)
