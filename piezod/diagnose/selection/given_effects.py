"""Effects of the given model within a search: held at their values, and what has become of each at the end.

A search starts from the given model, whole. Its effects stay at their values unless that leaves clearly more than other
values do. So a change of what is known is tried before a new effect that would imitate it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

from piezod.diagnose.hypothesis.chain import Chain, Point, Scope, Term
from piezod.diagnose.hypothesis.fit import Fitted, fit
from piezod.diagnose.hypothesis.parallel import each
from piezod.diagnose.selection.acceptance import degenerate, worth
from piezod.effects import EFFECTS
from piezod.model import Model
from piezod.model.parameters import EffectValues

Status = Literal["kept", "changed", "gone", "not seen"]
Values = Mapping[str, float]

TONES = ("vibration", "mains_hum")
"""Taken off the readings of their recording, and looked for there anew."""


def given_effects(model: Model, hashes: Sequence[str]) -> tuple[tuple[Term, ...], tuple[Values, ...]]:
    """Effects of the given model that act in the recordings, held, and their values.

    Parameters
    ----------
    model
        The given model.
    hashes
        SHA-256 of each recording.
    """
    terms, values = [], []
    for entry in model.effects:
        if entry.name in TONES or (entry.recording is not None and entry.recording not in hashes):
            continue
        number = -1 if entry.recording is None else hashes.index(entry.recording)
        effect = EFFECTS[entry.name]
        known = {one.name: entry.parameters.get(one.name, one.search.starts[0]) for one in effect.parameters}
        chosen = [one.name for one in effect.parameters if one.search.choices]
        choices = tuple((name, known.pop(name)) for name in chosen)
        terms.append(Term(effect, _scope(entry), number, choices, held=True))
        values.append(known)
    return tuple(terms), tuple(values)


def _scope(entry: EffectValues) -> Scope:
    """In which recordings an effect acts; of an older file it is known only that it was found later."""
    if entry.recording is not None:
        return "once"
    return "already" if entry.since == "identification" else "since"


def with_likelier_scope(chain: Chain, start: Point, terms: tuple[Term, ...], model: Model) -> tuple[Term, ...]:
    """The given effects, each in the recordings of the identification too where it fits better there.

    An older model file does not say since when an effect acts.

    Parameters
    ----------
    chain, start
        Recordings and base, with the values of the effects.
    terms, model
        The effects, and the given model.
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


def freed(chain: Chain, found: Fitted, name: str, past: Point | None = None) -> Fitted:
    """The hypothesis with the parameters of a held effect fitted too, from its own size, half of it and twice as much.

    From its own size alone, what shapes an effect goes astray where the size has changed much. The fits begin from the
    base as the identification alone shows it (`past`), since a change bends the base.
    """
    terms = tuple(replace(term, held=False) if term.effect.name == name else term for term in found.terms)
    place = next(k for k, term in enumerate(terms) if term.effect.name == name)
    size, values = terms[place].effect.size, found.point.values
    known = found.point if past is None or not past.alike(found.point) else past
    starts = [values]
    if size.name in values[place]:
        for factor in (0.5, 2.0):
            scaled = {**values[place], size.name: min(max(factor * values[place][size.name], size.low), size.high)}
            starts.append((*values[:place], scaled, *values[place + 1 :]))
    tried = each(lambda one: fit(chain, terms, replace(known, values=one)), starts)
    return min(tried, key=lambda one: one.loss)


def as_given(chain: Chain, found: Fitted, given: Fitted, name: str) -> Fitted:
    """The hypothesis with an effect as the given model has it, whatever has become of it."""
    return fit(chain, *_with_given(found, given, name))


def _with_given(found: Fitted, given: Fitted, name: str) -> tuple[tuple[Term, ...], Point]:
    pairs = [one for one in _pairs(found) if one[0].effect.name != name]
    pairs += [one for one in _pairs(given) if one[0].effect.name == name]
    return tuple(term for term, _ in pairs), replace(found.point, values=tuple(one for _, one in pairs))


def _pairs(fitted: Fitted) -> list[tuple[Term, Values]]:
    return list(zip(fitted.terms, fitted.point.values, strict=True))


def without_effect(chain: Chain, found: Fitted, name: str) -> Fitted:
    """The hypothesis without an effect."""
    pairs = [one for one in _pairs(found) if one[0].effect.name != name]
    point = replace(found.point, values=tuple(one for _, one in pairs))
    return fit(chain, tuple(term for term, _ in pairs), point)


def settle(chain: Chain, found: Fitted, given: Fitted) -> tuple[Fitted, dict[str, Status]]:
    """What has become of each given effect, and the hypothesis with it.

    Parameters
    ----------
    chain
        Recordings and base.
    found
        What the search found.
    given
        The base beside the given effects, all held.

    Returns
    -------
    found, statuses
        "kept" effects are held at their values, "gone" ones are left out. The recordings say nothing of one that is
        "not seen": they fit as well without it.
    """
    statuses: dict[str, Status] = {}
    for name in given.effects:
        same, without = as_given(chain, found, given, name), without_effect(chain, found, name)
        other = freed(chain, same, name)
        if name in found.effects:
            other = min(other, _last(found, name), key=lambda one: one.loss)
        if worth(same, other):
            gone = degenerate(chain, other) or not worth(without, other)
            found, statuses[name] = (without, "gone") if gone else (other, "changed")
        else:
            found, statuses[name] = same, "kept" if worth(without, same) else "not seen"
    return found, statuses


def _last(found: Fitted, name: str) -> Fitted:
    """The same hypothesis with an effect at its end."""
    order = sorted(range(len(found.terms)), key=lambda k: found.terms[k].effect.name == name)
    return replace(
        found,
        terms=tuple(found.terms[k] for k in order),
        point=replace(found.point, values=tuple(found.point.values[k] for k in order)),
        spread=tuple(found.spread[k] for k in order),
    )
