"""Effects of the given model in a search: held at their values, and classified at its end.

A search starts from the given model. Its effects keep their values unless other values fit clearly better. A changed
effect is tried before a new effect that would imitate it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from piezod.diagnose.hypothesis.chain import Chain
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.sampling import coarse, fit_from_each
from piezod.diagnose.hypothesis.terms import Point, Scope, Term
from piezod.diagnose.selection.acceptance import degenerate, worth
from piezod.diagnose.selection.known_values import JointEstimate, agreeing, joint_estimate
from piezod.diagnose.selection.linear_gain import LinearGains
from piezod.effects import EFFECTS
from piezod.model import Model
from piezod.model.information import Information
from piezod.model.parameters import EffectValues

Status = Literal["kept", "changed", "gone", "not seen"]
Values = Mapping[str, float]


def given_effects(model: Model, hashes: Sequence[str]) -> tuple[tuple[Term, ...], tuple[Values, ...]]:
    """Held terms and values of the given model's effects that act in the recordings with these SHA-256 `hashes`."""
    terms, values = [], []
    for entry in model.effects:
        if EFFECTS[entry.name].is_tone or (entry.recording is not None and entry.recording not in hashes):
            continue
        number = -1 if entry.recording is None else hashes.index(entry.recording)
        effect = EFFECTS[entry.name]
        known = {p.name: entry.parameters.get(p.name, p.search.starts[0]) for p in effect.parameters}
        chosen = [p.name for p in effect.parameters if p.search.choices]
        choices = tuple((name, known.pop(name)) for name in chosen)
        terms.append(Term(effect, _scope(entry), number, choices, held=True))
        values.append(known)
    return tuple(terms), tuple(values)


def tone_frequencies_Hz(model: Model) -> tuple[float, ...]:
    """Frequencies of the tones of the given model."""
    tones = [entry for entry in model.effects if EFFECTS[entry.name].is_tone]
    return tuple(dict.fromkeys(entry.parameters["frequency_Hz"] for entry in tones))


def _scope(entry: EffectValues) -> Scope:
    """Scope of an effect; without `since`, as in older files, it is assumed to have appeared later."""
    if entry.recording is not None:
        return "once"
    return "already" if entry.since == "identification" else "since"


def with_likelier_scope(chain: Chain, start: Point, terms: tuple[Term, ...], model: Model) -> tuple[Term, ...]:
    """Terms of the given model, with scope "already" for effects of an older file that fit better so.

    An older model file does not state since when an effect acts.
    """
    unknown = {entry.name for entry in model.effects if entry.since is None}
    if not unknown or not any(term.effect.name in unknown and term.scope == "since" for term in terms):
        return terms
    for place, term in enumerate(terms):
        if term.effect.name in unknown and term.scope == "since":
            other = (*terms[:place], replace(term, scope="already"), *terms[place + 1 :])
            if fit(chain, other, start).loss < fit(chain, terms, start).loss:
                terms = other
    return terms


def with_fitted_values(chain: Chain, fitted: Fitted, name: str, past: Point | None = None) -> Fitted:
    """Hypothesis with the parameters of a held effect fitted too, from its size, half of it and twice of it.

    Several starts are needed: if the size has changed much, a fit from the old size bends the shape. The fits begin
    from the base of the identification (`past`), since a change bends the base.
    """
    terms = tuple(replace(term, held=False) if term.effect.name == name else term for term in fitted.terms)
    place = next(k for k, term in enumerate(terms) if term.effect.name == name)
    size, values = terms[place].effect.size, fitted.point.values
    base = fitted.point if past is None or not past.alike(fitted.point) else past
    starts = [values]
    if size.name in values[place]:
        for factor in (0.5, 2.0):
            scaled = {**values[place], size.name: min(max(factor * values[place][size.name], size.low), size.high)}
            starts.append((*values[:place], scaled, *values[place + 1 :]))
    return fit_from_each(chain, terms, [replace(base, values=start) for start in starts])


def as_given(chain: Chain, fitted: Fitted, given: Fitted, name: str) -> Fitted:
    """Hypothesis, refitted with one effect as in the given model."""
    terms, values = without(fitted, name)
    for term, known in zip(given.terms, given.point.values, strict=True):
        if term.effect.name == name:
            terms.append(term)
            values.append(known)
    return fit(chain, terms, replace(fitted.point, values=tuple(values)))


def without(fitted: Fitted, name: str) -> tuple[list[Term], list[Values]]:
    """Terms and values of all other effects."""
    places = [k for k, term in enumerate(fitted.terms) if term.effect.name != name]
    return [fitted.terms[k] for k in places], [fitted.point.values[k] for k in places]


def refitted_without(chain: Chain, fitted: Fitted, name: str) -> Fitted:
    """Hypothesis, refitted without an effect."""
    terms, values = without(fitted, name)
    return fit(chain, terms, replace(fitted.point, values=tuple(values)))


def reordered(fitted: Fitted, order: Sequence[int]) -> Fitted:
    """Hypothesis with its terms in this order."""
    return replace(
        fitted,
        terms=tuple(fitted.terms[k] for k in order),
        point=replace(fitted.point, values=tuple(fitted.point.values[k] for k in order)),
        spread=tuple(fitted.spread[k] for k in order),
    )


@dataclass(frozen=True)
class Classified:
    """Hypothesis with the given effects as the recordings show them.

    Parameters
    ----------
    hypothesis
        A "kept" effect has its old values or joint estimates, and a "gone" effect is removed. A "not seen" effect has
        its old values too, but the recordings fit as well without it.
    statuses
        Status of each given effect.
    refined
        Joint estimates of kept effects that fit clearly better with other values, which agree with the old ones.
    """

    hypothesis: Fitted
    statuses: dict[str, Status]
    refined: dict[str, JointEstimate]


def classify_given(
    chain: Chain,
    tight: Chain,
    fitted: Fitted,
    given: Fitted,
    known: Information | None,
    count: int,
    least_gain: float,
) -> Classified:
    """Compare every given effect with the recordings: nothing is fitted for one that is clearly seen and unchanged.

    An effect has changed if other values fit clearly better, and the information on the old ones excludes them. A gain
    below `least_gain` is the error of the old values. Values that agree must suffice without another base: base
    and effect together were known better than each of them.

    Parameters
    ----------
    chain, fitted
        Recordings, and result of the search.
    tight
        Recordings with the base as well known as by the given model.
    given
        Base with all given effects held.
    known
        Information of the given model; None: its values are taken as exact.
    count
        Number of things that were tested: effects and tones of the given model, and gain and loops if these changed.
    least_gain
        Least gain of a change [noise variance].
    """
    statuses: dict[str, Status] = {}
    joint: dict[str, JointEstimate] = {}
    refined: dict[str, JointEstimate] = {}
    few = coarse(chain)
    linear = LinearGains(few, fitted)
    for name in given.effects:
        is_held = any(term.held for term in fitted.terms if term.effect.name == name)
        if is_held and linear.clearly_seen(name) and not linear.may_have_changed(name):
            statuses[name] = "kept"
            continue
        held, reduced = as_given(chain, fitted, given, name), refitted_without(chain, fitted, name)
        changed = with_fitted_values(chain, held, name)
        if name in fitted.effects:
            order = sorted(range(len(fitted.terms)), key=lambda k: fitted.terms[k].effect.name == name)
            changed = min(changed, reordered(fitted, order), key=lambda hypothesis: hypothesis.loss)
        if worth(held, changed):
            gone = degenerate(chain, changed) or not worth(reduced, changed)
            estimate = (
                None
                if gone or known is None
                else joint_estimate(chain, changed, given_values(given, name), name, known)
            )
            is_small = not gone and held.loss - changed.loss < least_gain
            fitted, statuses[name] = (reduced, "gone") if gone else (changed, "changed")
            if is_small:
                fitted, statuses[name] = held, "kept"
            if estimate is not None:
                (refined if is_small else joint)[name] = estimate
        else:
            fitted, statuses[name] = held, "kept" if worth(reduced, held) else "not seen"
        linear = LinearGains(few, fitted)
    few.forget()
    refined |= {
        name: estimate
        for name, estimate in agreeing(joint, count).items()
        if _explains(tight, fitted, name, estimate.values, least_gain)
    }
    for name, estimate in refined.items():
        fitted, statuses[name] = with_values(chain, fitted, name, estimate.values), "kept"
    return Classified(fitted, statuses, refined)


def _explains(tight: Chain, fitted: Fitted, name: str, values: Values, least_gain: float) -> bool:
    """Whether values of an effect explain the recordings as well as fitted ones, without another base."""
    averaged, free = with_values(tight, fitted, name, values), fit(tight, fitted.terms, fitted.point)
    return not worth(averaged, free) or averaged.loss - free.loss < least_gain


def given_values(given: Fitted, name: str) -> Values:
    """Values of an effect in a hypothesis."""
    return next(
        values for term, values in zip(given.terms, given.point.values, strict=True) if term.effect.name == name
    )


def with_values(chain: Chain, fitted: Fitted, name: str, known: Values) -> Fitted:
    """Hypothesis, refitted with an effect held at these values."""
    terms = tuple(replace(term, held=True) if term.effect.name == name else term for term in fitted.terms)
    values = tuple(
        known if term.effect.name == name else values
        for term, values in zip(fitted.terms, fitted.point.values, strict=True)
    )
    return fit(chain, terms, replace(fitted.point, values=values))
