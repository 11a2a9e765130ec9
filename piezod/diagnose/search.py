"""The search: grow a hypothesis by the effect that explains most of what is left, then try to swap and to drop."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.chain import Chain, Point, Scope, Term
from piezod.diagnose.direct import noise_of
from piezod.diagnose.fit import MOST_STEPS, Fitted, Normal, fit
from piezod.diagnose.ideas import Idea, screened, since
from piezod.diagnose.motion import motion
from piezod.diagnose.parallel import each
from piezod.diagnose.series import Series
from piezod.diagnose.steps import NEVER_S, Step, likely_steps, sharp
from piezod.diagnose.tones import Tone, tones, without_tones
from piezod.effects import EFFECTS
from piezod.effects.effect import HELD_BEFORE, STRAIGHT
from piezod.identify.start import CLEARLY, start_at_zero, starts_at_rest

Array = NDArray[np.float64]
OnProgress = Callable[[str], None]

MOST_EFFECTS = 5
TRIED = 7  # effects that are really fitted in a round, first coarsely
TRIED_FROM_PAST = 3
FINALISTS = 3  # of them that are tried with every course of the command between samples
REFINED = 4  # of them thoroughly
COMPARED = 6  # of all these on more samples
NEAR = 0.4  # of the best one's gain, from which one is fitted thoroughly, or on more samples
FEWEST_REFINED, FEWEST_COMPARED = 2, 3
COARSE_STEPS, COARSE_ROWS = 7, 6000
NOTHING = 0.003  # of the loss: an idea that promises less is not tried
PROMISING = 0.03  # of the best idea's gain, below which an idea is not tried
WORTH = 0.04  # of the loss that is left: what an effect must gain at least
MUCH = 0.3  # of the loss: where a few blocks hold nearly all of it, an effect may gain in these alone,
NOTICED, FEW = 0.05, 0.25  # if not more than so many blocks grow worse
NEAR_A_MODE = 0.05  # of its frequency: a line there is its own ringing
DOMINANT = 0.3  # of the loss: a tone without which so little is left is taken off before anything else is tried
MOST_OF_A_BLOCK = 3.0  # times the median gain
STEADY = 2.5  # standard deviations of the blocks' gains
WORTH_WHEN_SMALL, STEADY_WHEN_SMALL, LEFT_WHEN_SMALL = 0.08, 3.0, 0.05
LOOSE = (
    "friction",
    "rate_dependent_hysteresis",
    "noncongruent_minor_loops",
    "gain_drift",
    "creep",
    "output_nonlinearity",
    "contact_gap",
)
SMALLEST_SHARE = 5e-4  # of the largest gain: below it is what no form of the larger effect fits exactly
FAIR_SHARE = 0.02  # of the largest gain so far: more effects than that are the plant's own shape
HELD_PARTS = (0.3, 0.7)  # of a sample after its command, where the search for the moment of reading begins
SMALLEST_PART = 0.04
LATE = 0.05  # of a sample
RINGS = 0.6  # damping ratio beyond which nothing is seen to ring
SLIDES = 0.5  # of the force's range: friction with a longer presliding never slides
START_LOOKED_AT_S = 20.0
SAME = 0.005  # of the loss
PLAINER = 0.002  # of the loss, that a parameter must bring for its effect to be chosen


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
    past
        The base as the recordings show it that the model was identified on.
    rounds
        In the order of the search.
    tones
        What was taken off the readings of the chain's series.
    """

    chain: Chain
    base: Fitted
    found: Fitted
    past: Point
    rounds: list[Round] = field(default_factory=list)
    tones: list[Tone] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that were found, tones last."""
        return tuple(dict.fromkeys((*self.found.effects, *(tone.name for tone in self.tones))))


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
    result = Search(chain, base, base, _past(chain, start))
    largest = 0.0
    while len(result.names) < MOST_EFFECTS:
        progress(f"looking for effect {len(result.names) + 1}")
        heard = _heard(result)
        if heard is not None and heard[1].loss < DOMINANT * result.found.loss:
            _listen(result, heard)
            largest = max(result.base.loss - result.found.loss, 0.0)
            continue
        tried = _on_each_course(result.chain, result.found, result.past)
        better = [
            (chain, one)
            for chain, one in tried
            if worth(result.found, one) and not _degenerate(chain, one) and _fair(chain, result.found, one, largest)
        ]
        settled = each(_settled, sorted(better, key=lambda one: one[1].loss)[:FINALISTS])
        best = min(settled, key=lambda one: _weighed(one[1]), default=None)
        if heard is not None and (best is None or heard[1].loss < best[1].loss):
            _listen(result, heard)
            largest = max(result.base.loss - result.found.loss, 0.0)
            continue
        if best is None:
            break
        before, (result.chain, result.found) = result.found, best
        largest = max(largest, before.loss - result.found.loss)
        others = tuple(one for _, one in tried if one.effects[-1] != result.found.effects[-1])
        result.rounds.append(Round(before, result.found, others))
    progress("trying to swap and to drop")
    _swap(result)
    _drop(result, largest)
    _polish(result)
    return result


Heard = tuple[Chain, Fitted, list[Tone]]


def _heard(result: Search) -> Heard | None:
    """The strongest tone taken off, where that lowers the loss enough."""
    normal = Normal.at(result.chain, result.found.terms, result.found.point)
    residuals = [one.reading_N - modelled for one, modelled in zip(result.chain.series, normal.readings, strict=True)]
    modes_Hz = [
        values["frequency_Hz"]
        for term, values in zip(result.found.terms, result.found.point.values, strict=True)
        if term.effect.name == "resonance"
    ]
    for group in tones(result.chain.series, residuals, result.tones)[:2]:
        if any(abs(group[0].values["frequency_Hz"] / mode_Hz - 1.0) < NEAR_A_MODE for mode_Hz in modes_Hz):
            continue
        chain = result.chain.like(without_tones(result.chain.series, group))
        fitted = fit(chain, result.found.terms, result.found.point, most_steps=6)
        if result.found.loss - fitted.loss > WORTH * fitted.loss:
            return chain, fitted, group
    return None


def _listen(result: Search, heard: Heard) -> None:
    """Take a tone off; what was counted as noise before may have been the tone."""
    chain, _, new = heard
    series = list(chain.series)
    for number in {tone.number for tone in new}:
        one = series[number]
        series[number] = replace(one, noise_N=noise_of(one.command_V, one.reading_N, one.counts))
    result.chain = chain.like(series)
    result.tones += new
    result.found = fit(result.chain, result.found.terms, result.found.point)
    result.base = fit(result.chain, (), result.base.point)


def _settled(one: tuple[Chain, Fitted]) -> tuple[Chain, Fitted]:
    """A hypothesis with the course and the starts that suit it best."""
    chain, fitted = one
    coarse = _coarse(chain)
    known = fit(coarse, fitted.terms, fitted.point, most_steps=2)
    settled, again = restarted(*_best_course(coarse, fitted.terms, fitted.point, known))
    if again is known:
        return one
    fine = chain.like(settled.series)
    return fine, fit(fine, again.terms, again.point, most_steps=6)


def restarted(chain: Chain, fitted: Fitted) -> tuple[Chain, Fitted]:
    """The same with what led to each start estimated anew: under the given model an effect may have passed for it."""
    series = list(chain.series)
    resting = [k for k, one in enumerate(chain.series) if starts_at_rest(one.command_V)]
    for number in resting:
        one = chain.series[number]
        loss = partial(_loss_of_start, chain, fitted, number)
        path = start_at_zero(one.command_V, "V", loss).path
        usual = chain.series[resting[0]].path_V  # a bench that is not used between its recordings starts them alike
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


def _polish(result: Search) -> None:
    """Base and hypothesis once more on all samples."""
    result.chain = result.chain.like(result.chain.series, max(map(_length, result.chain.series)))
    result.found = fit(result.chain, result.found.terms, result.found.point, most_steps=4)
    result.base = fit(result.chain, (), result.base.point, most_steps=4)


def _length(series: Series) -> int:
    return int(series.time_s.size)


def worth(before: Fitted, after: Fitted) -> bool:
    """Whether an effect gains enough on blocks left out, and in most of them or very much."""
    gain = before.loss - after.loss
    if gain < WORTH * after.loss:
        return False
    if after.terms[-1].scope == "once":
        return True
    gains = np.log(before.losses / after.losses)
    if gain > MUCH * before.loss and np.mean(gains < -NOTICED) < FEW:
        return True
    return _steadiness(before, after) > STEADY


def _weighed(fitted: Fitted) -> float:
    """The loss, a little more of it for every parameter that the last effect is shaped by: of two alike the plainer."""
    return fitted.loss * (1.0 + PLAINER * len(fitted.terms[-1].searched))


def _steadiness(before: Fitted, after: Fitted) -> float:
    """Sum of the blocks' logarithmic gains over its standard deviation if their signs were chance.

    A block that gains or loses far more than most counts no more than some of them: it would drown what they say.
    """
    gains = np.log(before.losses / after.losses)
    touched = gains[np.abs(gains) > 1e-3]
    if touched.size < 4:
        return 0.0
    most = MOST_OF_A_BLOCK * float(np.median(np.abs(touched)))
    touched = np.clip(touched, -most, most)
    return float(np.sum(touched)) / float(np.sqrt(np.sum(touched**2)))


def _fair(chain: Chain, before: Fitted, after: Fitted, largest: float) -> bool:
    """Whether an effect is more than the remainder of a larger one that has not quite the plant's shape.

    A small one must gain steadily; one that takes many shapes must leave nothing that depends on movement or level.
    """
    gain = before.loss - after.loss
    if gain >= FAIR_SHARE * largest or after.terms[-1].scope == "once":
        return True
    if gain < SMALLEST_SHARE * largest:
        return False
    if gain < WORTH_WHEN_SMALL * after.loss or _steadiness(before, after) < STEADY_WHEN_SMALL:
        return False
    if after.effects[-1] not in LOOSE:
        return True
    modelled = [chain.run(k, after.terms, after.point).reading_N for k in range(len(chain.series))]
    residuals = [one.reading_N - model for one, model in zip(chain.series, modelled, strict=True)]
    left = motion(chain.series, residuals, modelled)
    return max(left.share, left.level_share) < LEFT_WHEN_SMALL


def _degenerate(chain: Chain, fitted: Fitted) -> bool:
    """Whether the last effect is not what its name says.

    Friction that never slides is a gain, a resonance that does not ring is a lag, a step without edges is a drift; what
    is late by next to nothing of a sample is the moment of reading.
    """
    term, values = fitted.terms[-1], fitted.point.values[-1]
    if term.effect.name == "friction":
        return values["presliding_N"] > SLIDES * chain.parameter(term.effect, "presliding_N").high
    if term.effect.name == "resonance":
        return values["damping_ratio"] > RINGS
    late_s = {
        "electrical_lag": values.get("time_constant_s", 0.0),
        "transport_delay": values.get("delay_s", 0.0),
        "sensor_filter": 1.0 / (2.0 * np.pi * values.get("cutoff_Hz", np.inf)),
        "clock_skew": 1e-6 * abs(values.get("skew_ppm", 0.0)) * max(one.duration_s for one in chain.series),
    }.get(term.effect.name)
    if late_s is not None:
        return late_s < LATE * min(one.dt_s for one in chain.series)
    if term.effect.name == "load_step":
        series = chain.series[term.series]
        residual_N = series.reading_N - chain.run(term.series, fitted.terms, fitted.point).reading_N
        first, end = (round(values[name] / series.dt_s) for name in ("on_s", "off_s"))
        return not sharp(series, residual_N, Step(values["step_N"], first, min(end, series.time_s.size)))
    return False


def _best_course(
    chain: Chain, terms: Sequence[Term], point: Point, known: Fitted | None = None
) -> tuple[Chain, Fitted]:
    """The course of the command between samples under which a hypothesis fits best.

    Held commands differ from each other only where something smooths them.
    """
    smooth = any(term.effect.smooths for term in terms)
    results: dict[float, tuple[Chain, Fitted]] = {}
    if known is not None:
        results[chain.series[0].between] = (chain, known)

    def best() -> float:
        found = min(results, key=lambda between: results[between][1].loss)
        straight = results.get(STRAIGHT)
        if straight is not None and straight[1].loss <= (1.0 + SAME) * results[found][1].loss:
            return STRAIGHT  # a held command read late and a delay are the same
        return found

    def judged(between: float) -> None:
        if between not in results:
            series = [replace(one, between=between) for one in chain.series]
            other = chain.like(series)
            results[between] = (other, fit(other, terms, point, most_steps=MOST_STEPS if known is None else 6))
            other.forget()

    for between in (STRAIGHT, *(HELD_PARTS if smooth else ()), HELD_BEFORE):
        judged(between)
    width = 0.5 * (HELD_PARTS[1] - HELD_PARTS[0])
    while STRAIGHT < best() < HELD_BEFORE and width > SMALLEST_PART:
        middle = best()
        for between in (middle - width, middle + width):
            if 0.0 < between <= 1.0:
                judged(between)
        width *= 0.5
    return results[best()]


def _past(chain: Chain, start: Point) -> Point:
    """The base fitted to the recordings of the identification alone, the others shifted onto it."""
    known = [k for k, one in enumerate(chain.series) if one.role == "identification"]
    alone = chain.like([chain.series[k] for k in known])
    point = fit(alone, (), replace(start, offsets_N=start.offsets_N[known])).point
    offsets_N = np.zeros(len(chain.series))
    offsets_N[known] = point.offsets_N
    return replace(point, offsets_N=offsets_N)


def _on_each_course(chain: Chain, found: Fitted, past: Point) -> list[tuple[Chain, Fitted]]:
    """Hypotheses with one more effect, with the chain that each was fitted on.

    Where the command seems to be held although nothing smooths it, an effect that makes late may have passed for that:
    all is tried with a straight course too.
    """
    chains = [(chain, found)]
    if chain.series[0].between != STRAIGHT and not any(term.effect.smooths for term in found.terms):
        straight = chain.like([replace(one, between=STRAIGHT) for one in chain.series])
        chains.append((straight, fit(straight, found.terms, found.point, most_steps=6)))
    found_on = []
    for on, known in chains:
        coarse = _coarse(on)
        tried = _tried(coarse, known, past)
        coarse.forget()
        found_on += [(on, one) for one in _fine(on, known, tried)]
    return found_on


def _coarse(chain: Chain) -> Chain:
    return chain.like(chain.series, COARSE_ROWS)


def _fine(chain: Chain, before: Fitted, tried: Sequence[Fitted]) -> list[Fitted]:
    """The best of what was fitted on few samples, fitted on more."""
    best = sorted(tried, key=lambda one: one.loss)
    enough = before.loss - NEAR * (before.loss - best[0].loss) if best else 0.0
    near = sum(one.loss < enough for one in best[:COMPARED])
    return each(lambda one: fit(chain, one.terms, one.point, most_steps=6), best[: max(near, FEWEST_COMPARED)])


def _tried(chain: Chain, found: Fitted, past: Point) -> list[Fitted]:
    """Hypotheses with one more effect: all promising ones fitted in few steps, the best of them thoroughly.

    From what was found so far, and those that came since from their best start from the `past` too: a strong effect
    bends the base towards itself.
    """
    ideas = screened(chain, found.terms, found.point)
    enough = (
        NOTHING
        * found.loss
        * sum(float(one.counts[rows].sum()) for one, rows in zip(chain.series, chain.rows, strict=True))
    )
    chosen: dict[str, list[Idea]] = {}
    for idea in ideas:
        if idea.gain < max(PROMISING * ideas[0].gain, enough):
            break
        if len(chosen) < TRIED or idea.term.effect.name in chosen:
            chosen.setdefault(idea.term.effect.name, []).append(idea)
    quick = each(lambda some: (_extended(chain, found, some[0], most_steps=COARSE_STEPS), some), list(chosen.values()))
    bases = [replace(past, values=found.point.values), *([found.point] if found.terms else [])]
    lost_N = -min(found.point.offsets_N[k] for k, one in enumerate(chain.series) if one.role == "recording")
    starts = [one for base in bases for one in since(chain, found.terms, base, lost_N)[:TRIED_FROM_PAST]]
    quick += each(partial(_from_past, chain, found.terms), starts)
    quick.sort(key=lambda one: one[0].loss)
    quick = [one for k, one in enumerate(quick) if one[0].effects[-1] not in (o[0].effects[-1] for o in quick[:k])]
    enough = found.loss - NEAR * (found.loss - quick[0][0].loss) if quick else 0.0
    near = sum(one.loss < enough for one, _ in quick[:REFINED])
    refined = max(near, FEWEST_REFINED)
    thorough = each(lambda one: _refined(chain, found, *one), quick[:refined])
    direct = each(lambda idea: _extended(chain, found, idea), suggested(chain, found))
    return [*thorough, *(first for first, _ in quick[refined:]), *direct]


def _from_past(chain: Chain, terms: tuple[Term, ...], one: tuple[Idea, Point]) -> tuple[Fitted, list[Idea]]:
    idea, past = one
    point = replace(past, values=(*past.values, idea.values))
    return fit(chain, (*terms, idea.term), point, most_steps=COARSE_STEPS), [idea]


def _refined(chain: Chain, found: Fitted, first: Fitted, ideas: Sequence[Idea]) -> Fitted:
    """The best fit of one effect: from its second start too, in both scopes, with every choice."""
    best = fit(chain, first.terms, first.point)
    others = [idea for idea in ideas[1:] if idea.values != ideas[0].values and idea.gain > 0.3 * ideas[0].gain]
    for idea in others[:2]:
        best = min(best, _extended(chain, found, idea), key=lambda one: one.loss)
    scopes: tuple[Scope, ...] = ("since", "already")
    for scope in scopes:
        if scope != best.terms[-1].scope:
            best = min(best, _again(chain, best, scope=scope), key=lambda one: one.loss)
    for parameter in best.terms[-1].effect.parameters:
        for choice in parameter.choices:
            if (parameter.name, choice) not in best.terms[-1].choices:
                best = min(best, _again(chain, best, choice=(parameter.name, choice)), key=lambda one: one.loss)
    return best


def _extended(chain: Chain, found: Fitted, idea: Idea, most_steps: int = MOST_STEPS) -> Fitted:
    point = replace(found.point, values=(*found.point.values, idea.values))
    return fit(chain, (*found.terms, idea.term), point, most_steps=most_steps)


def _again(
    chain: Chain, fitted: Fitted, *, scope: Scope | None = None, choice: tuple[str, float] | None = None
) -> Fitted:
    """The same hypothesis with another scope or choice of its last effect."""
    last = fitted.terms[-1]
    if scope is not None:
        last = replace(last, scope=scope)
    if choice is not None:
        last = replace(last, choices=tuple(choice if one[0] == choice[0] else one for one in last.choices))
    return fit(chain, (*fitted.terms[:-1], last), fitted.point, most_steps=6)


def suggested(chain: Chain, found: Fitted) -> list[Idea]:
    """Steps of the load that the residuals suggest."""
    if "load_step" in found.effects:
        return []
    normal = Normal.at(chain, found.terms, found.point)
    ideas = []
    for number, series in enumerate(chain.series):
        if series.role == "identification":
            continue
        for step in likely_steps(normal, number):
            end_s = NEVER_S if step.end == series.time_s.size else step.end * series.dt_s
            places = {"step_N": step.height_N, "on_s": step.first * series.dt_s, "off_s": end_s}
            ideas.append(_idea("load_step", number, places))
    return ideas


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
    if len(result.found.effects) == 1:
        return
    for name in result.found.effects:
        rivals = [
            one
            for round_ in result.rounds
            if round_.accepted.effects[-1] == name
            for one in round_.others
            if one.effects[-1] not in result.found.effects
        ]
        best = sorted(rivals, key=lambda one: one.loss)[:2]
        swapped = each(partial(_with_instead, result.chain, result.found, name), best)
        fitting = [one for one in swapped if not _degenerate(result.chain, one)]
        if fitting and min(one.loss for one in fitting) < 0.98 * result.found.loss:
            result.found = min(fitting, key=lambda one: one.loss)


def _with_instead(chain: Chain, found: Fitted, name: str, rival: Fitted) -> Fitted:
    terms, values = without(found, name)
    last = [k for k, term in enumerate(rival.terms) if term.effect.name == rival.effects[-1]]
    terms += [rival.terms[k] for k in last]
    values += [rival.point.values[k] for k in last]
    return fit(chain, terms, replace(found.point, values=tuple(values)))


def without(found: Fitted, name: str) -> tuple[list[Term], list[Mapping[str, float]]]:
    """Terms of all other effects, and their values."""
    kept = [k for k, term in enumerate(found.terms) if term.effect.name != name]
    return [found.terms[k] for k in kept], [found.point.values[k] for k in kept]


def _drop(result: Search, largest: float) -> None:
    """Leave out effects that the others have made needless."""
    left = list(result.found.effects)
    while left and len(result.found.effects) > 1:
        found = result.found
        terms, values = without(found, left.pop(0))
        fewer = fit(result.chain, terms, replace(found.point, values=tuple(values)))
        gain = fewer.loss - found.loss
        small = gain < FAIR_SHARE * largest and _steadiness(fewer, found) < STEADY_WHEN_SMALL
        if gain < WORTH * found.loss or small:
            result.found = fewer
            left = list(fewer.effects)


__all__ = ["Round", "Search", "search", "suggested", "without", "worth"]
