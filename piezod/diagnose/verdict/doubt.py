"""Which names are left out again: what gains nothing in the end, is not determined, or is believed least."""

from collections.abc import Mapping, Sequence

from piezod.diagnose.findings import Finding, Findings
from piezod.diagnose.hypothesis.stack_change import NAMES
from piezod.diagnose.selection.acceptance import BETTER
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.verdict.words import Wording, label_of, value_words
from piezod.effects import EFFECTS

LEAST_CONFIDENCE = 0.6  # below which an effect is not named: more likely it is the shape of something else,
DECADE = 10.0  # between the ends of an interval: of a size that is known no better nobody can say what it does
LEFT_BY_ONE = 0.25  # unless it leaves no more of the squared error than that: it halves the error


def confidences(findings: Findings, before: Mapping[str, float] | None = None) -> dict[str, float]:
    """The highest confidence that each effect has or had `before`, by name."""
    highest = dict(before or {})
    for one in findings.effects:
        highest[one.name] = max(one.confidence, highest.get(one.name, 0.0))
    return highest


def needless(result: Search, findings: Findings, *, delivered: bool) -> list[str]:
    """An effect that gains nothing without plays that fold, or on all samples.

    All of them where the model that is `delivered` with them leaves as much as the given one.
    """
    unlike = [*result.new, *(one.name for one in findings.effects if one.name in result.given)]
    unlike += [name for name in NAMES if name in result.found.effects]
    if unlike and delivered and findings.after**2 > BETTER * findings.before**2:
        return unlike
    named = (one for one in findings.effects if one.name in result.names)
    return [one.name for one in named if BETTER * one.before**2 < one.after**2][:1]


def not_determined(findings: Findings) -> list[str]:
    """The new effect that is believed least of those whose size these recordings do not determine.

    Its interval holds zero or more than a decade, or the best value is a bound of what an effect of this kind can have.
    """
    fitted = [one for one in findings.effects if one.status == "new" and one.after != one.before]
    unknown = [one for one in fitted if not _is_determined(one)]
    return [min(unknown, key=lambda one: one.confidence).name] if unknown else []


def _is_determined(finding: Finding) -> bool:
    size = EFFECTS[finding.name].size
    value = finding.parameters[size.name]
    low, high = value.in_fit or (value.low, value.high)
    ends = sorted((abs(low), abs(high)))
    is_within = bool(size.search.choices) or size.low < value.value < size.high
    return low * high > 0.0 and ends[1] <= DECADE * ends[0] and is_within


def experiments_for(findings: Findings, names: Sequence[str], wording: Wording) -> list[str]:
    """What a reader is told of effects whose size is not determined, with the experiment that would determine it."""
    said = []
    for one in findings.effects:
        if one.name in names:
            size = EFFECTS[one.name].size
            middle, interval = value_words(one.parameters[size.name], size.name, one.name, wording)
            said.append(
                f"{one.title} would explain a part, {one.before:.3g} -> {one.after:.3g} {findings.unit}, but "
                f"{label_of(size.name, size.unit)} is not determined by these recordings: {middle} ({interval}); "
                f"record {EFFECTS[one.name].separate_by}"
            )
    return said


def least_believed(result: Search, findings: Findings, surest: Mapping[str, float]) -> list[str]:
    """The effect that is believed least, where that is too little and much is left with it too.

    An effect that was left out may have taken a part of another. What it took counts as left beside the other, so the
    highest confidence of each decides.

    Parameters
    ----------
    result, findings
        What a search found, and how sure it is.
    surest
        Highest confidence that each effect has or had, by name.
    """
    named = (one for one in findings.effects if one.name in result.names and surest[one.name] < LEAST_CONFIDENCE)
    weak = [one for one in named if one.after**2 > LEFT_BY_ONE * one.before**2]
    return [min(weak, key=lambda one: one.confidence).name] if weak else []


def needed(with_it: Findings, without_it: Findings) -> bool:
    """Whether a recording is explained with an effect and is not without it."""
    return with_it.verdict == "explained" and without_it.verdict not in ("explained", "matches")


def not_believed(findings: Findings, doubtful: Sequence[str]) -> list[str]:
    """What a reader is told of effects that came near and are not named."""
    return [
        f"{one.name} would explain a part, {one.before:.3g} -> {one.after:.3g} {findings.unit}, but is not believed "
        f"(confidence {one.confidence:.2f}{'' if one.q is None else f', false-discovery rate {one.q:.2g}'})"
        for one in findings.effects
        if one.name in doubtful and one.confidence < LEAST_CONFIDENCE and one.after < one.before
    ]
