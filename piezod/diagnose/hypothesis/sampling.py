"""Choice of the hold of the command, and of the initial state of each recording, for a hypothesis."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from piezod.arrays import Array
from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import MOST_STEPS, Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.hypothesis.terms import Point, Term
from piezod.estimation.recordings.start import CLEARLY, START_WINDOW_S, loss_of_start, start_at_zero, starts_at_rest
from piezod.recording.hold import HELD_BEFORE, STRAIGHT, Hold

HELD_PARTS = (0.3, 0.7)  # [samples] from the command to the reading: where the search of that time begins
SMALLEST_PART = 0.04  # [samples] where it ends
EQUAL = 0.005  # relative difference of two losses that counts as none
COARSE_ROWS = 6000  # compared samples of a recording while many hypotheses are tried
COARSE_STEPS, FINE_STEPS = 5, 6  # Gauss-Newton steps of a coarse fit, and of a fit from its result to more samples


def with_best_hold(hypothesis: tuple[Chain, Fitted]) -> tuple[Chain, Fitted]:
    """Hypothesis with the hold and the initial states that fit best."""
    return _refitted(*hypothesis, holds=True) or hypothesis


def with_refitted_starts(hypothesis: tuple[Chain, Fitted]) -> tuple[Chain, Fitted] | None:
    """Hypothesis with the best initial states, and the best hold if its last effect smooths; None for no change."""
    return _refitted(*hypothesis, holds=hypothesis[1].terms[-1].effect.smooths)


def _refitted(chain: Chain, fitted: Fitted, *, holds: bool) -> tuple[Chain, Fitted] | None:
    few = coarse(chain)
    known = fit(few, fitted.terms, fitted.point, most_steps=2)
    held = best_intersample(few, fitted.terms, fitted.point, known) if holds else (few, known)
    best, again = with_usual_start(*refit_starts(*held))
    if again is known:
        return None
    fine = chain.like(best.series)
    return fine, fit(fine, again.terms, again.point, most_steps=FINE_STEPS)


def with_equal_starts(chain: Chain) -> Chain | None:
    """Chain whose recordings from rest start as the first of the identification does; None for no change."""
    resting = _resting(chain)
    return _started(chain, chain.series[resting[0]].path_V) if resting else None


def with_usual_start(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """Hypothesis with the starts of the identification, or de-energised ones, where its refit is better.

    A start that was estimated without an effect bends the parameters of the effect, so each start needs a refit.
    """
    best = chain, fitted
    for other in (with_equal_starts(chain), _started(chain, ())):
        if other is not None:
            again = fit(other, fitted.terms, fitted.point)
            best = min(best, (other, again), key=lambda pair: pair[1].loss)
    return best


def _started(chain: Chain, path_V: tuple[float, ...]) -> Chain | None:
    """Chain whose recordings from rest start after `path_V`; None for no change."""
    resting = _resting(chain)
    if all(chain.series[k].path_V == path_V for k in resting):
        return None
    series = [replace(known, path_V=path_V) if k in resting else known for k, known in enumerate(chain.series)]
    return chain.like(series)


def _resting(chain: Chain) -> list[int]:
    """Numbers of the recordings that start at rest."""
    return [k for k, series in enumerate(chain.series) if starts_at_rest(series.command_V)]


def refit_starts(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """Hypothesis with each initial state estimated again, because the first estimate lacked the effects."""
    series, resting = list(chain.series), _resting(chain)
    for number in resting:
        recording = chain.series[number]
        first = slice(0, int(START_WINDOW_S / recording.dt_s))
        readings = partial(_readings_after, chain, fitted, number)
        loss = loss_of_start(readings, recording.reading_N[first], recording.counts[first])
        path = start_at_zero(recording.command_V, "V", loss).path
        usual = series[resting[0]].path_V  # a bench that is not used between its recordings starts them alike
        if loss(path) >= CLEARLY * loss(usual):
            path = usual
        if loss(path) < (1.0 if path == usual else CLEARLY) * loss(recording.path_V):
            series[number] = replace(recording, path_V=path)
    if all(new is old for new, old in zip(series, chain.series, strict=True)):
        return chain, fitted
    other = chain.like(series)
    again = fit(other, fitted.terms, fitted.point)
    return (other, again) if again.loss < fitted.loss else (chain, fitted)


def _readings_after(chain: Chain, fitted: Fitted, number: int, path_V: tuple[float, ...]) -> Array:
    """Simulated readings of a recording that starts after `path_V`, shape (N,) [N]."""
    series = list(chain.series)
    series[number] = replace(series[number], path_V=path_V)
    return chain.like(series).run(number, fitted.terms, fitted.point).reading_N


def best_intersample(
    chain: Chain, terms: Sequence[Term], point: Point, known: Fitted | None = None
) -> tuple[Chain, Fitted]:
    """Hypothesis with the hold of the command that fits best.

    The time from a held command to the reading matters only with an effect that smooths.
    """
    smooth = any(term.effect.smooths for term in terms)
    results: dict[Hold, tuple[Chain, Fitted]] = {}
    if known is not None:
        results[chain.series[0].hold] = (chain, known)

    def best() -> Hold:
        least = min(results, key=lambda hold: results[hold][1].loss)
        straight = results.get(STRAIGHT)
        if straight is not None and straight[1].loss <= (1.0 + EQUAL) * results[least][1].loss:
            return STRAIGHT  # a held command that is read late has the equation of a delay
        return least

    def try_hold(hold: Hold) -> None:
        if hold not in results:
            other = chain.like([replace(known, hold=hold) for known in chain.series])
            results[hold] = (other, fit(other, terms, point, most_steps=MOST_STEPS if known is None else FINE_STEPS))
            other.forget()

    for hold in (STRAIGHT, *(Hold("held", part) for part in HELD_PARTS if smooth), HELD_BEFORE):
        try_hold(hold)
    width = 0.5 * (HELD_PARTS[1] - HELD_PARTS[0])
    while best().sampling == "held" and width > SMALLEST_PART:
        middle = best().read_after
        for read_after in (middle - width, middle + width):
            if 0.0 < read_after <= 1.0:
                try_hold(Hold("held", read_after))
        width *= 0.5
    return results[best()]


def fit_from_each(chain: Chain, terms: Sequence[Term], starts: Sequence[Point]) -> Fitted:
    """Fit from the best of several starts, which is chosen by coarse fits."""
    few = coarse(chain)
    best = best_coarsely(few, terms, starts)
    few.forget()
    return fit(chain, terms, best.point)


def best_coarsely(few: Chain, terms: Sequence[Term], starts: Sequence[Point]) -> Fitted:
    """Best of the coarse fits from several starts."""
    tried = each(lambda start: fit(few, terms, start, most_steps=COARSE_STEPS, robust=False), starts)
    return min(tried, key=lambda fitted: fitted.loss)


def coarse(chain: Chain) -> Chain:
    """Chain that compares `COARSE_ROWS` samples of each recording."""
    return chain.like(chain.series, COARSE_ROWS)
