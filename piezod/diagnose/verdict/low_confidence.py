"""Rules that remove effects after the search: no gain, undetermined size, or low confidence."""

from collections.abc import Mapping, Sequence

from piezod.diagnose.findings import Finding, Findings
from piezod.diagnose.hypothesis.stack_change import NAMES
from piezod.diagnose.rules import RULES
from piezod.diagnose.selection.search_state import Search
from piezod.diagnose.verdict.words import Wording, confidence_words, label_of, value_words
from piezod.effects import EFFECTS

LEAST_CONFIDENCE = 0.6  # lowest confidence of a name; in two study sets 3 of 17 names with 0.43 to 0.84 were right
NEVER_NAMED = 0.2  # confidence below which no effect is named, however much it explains: four of five would be wrong
CONTRADICTED = (
    0.05  # confidence below which no effect stays, however sure it once was: nearly all that is left is another
)
DECADE = 10.0  # largest ratio of an interval's ends; a wider interval does not determine the size
HALVED_ERROR = 0.25  # share of the squared error; an effect that leaves less is named below `LEAST_CONFIDENCE` too


def highest_confidences(findings: Findings, before: Mapping[str, float] | None = None) -> dict[str, float]:
    """Highest confidence of each effect in these findings and `before`, by name."""
    highest = dict(before or {})
    for finding in findings.effects:
        highest[finding.name] = max(finding.confidence, highest.get(finding.name, 0.0))
    return highest


def effects_without_gain(result: Search, findings: Findings, *, delivered: bool) -> list[str]:
    """Effects that do not lower the error.

    All new and changed effects, if the `delivered` model with them leaves as much as the given model. Otherwise the
    first effect that gains nothing with a monotone loading curve and on all samples.
    """
    differences = [*result.new, *(finding.name for finding in findings.effects if finding.name in result.given)]
    differences += [name for name in NAMES if name in result.hypothesis.effects]
    if differences and delivered and findings.after**2 > RULES.better * findings.before**2:
        return differences
    named = (finding for finding in findings.effects if finding.name in result.names)
    return [finding.name for finding in named if RULES.better * finding.before**2 < finding.after**2][:1]


def undetermined_effect(findings: Findings) -> list[str]:
    """The least confident new effect whose size these recordings do not determine; empty if there is none.

    Its interval contains zero or spans more than a decade, or its size lies at the end of the allowed range.
    """
    fitted = [finding for finding in findings.effects if finding.status == "new" and finding.after != finding.before]
    undetermined = [finding for finding in fitted if not _is_determined(finding)]
    return [min(undetermined, key=lambda finding: finding.confidence).name] if undetermined else []


def _is_determined(finding: Finding) -> bool:
    size = EFFECTS[finding.name].size
    value = finding.parameters[size.name]
    low, high = value.in_fit or (value.low, value.high)
    ends = sorted((abs(low), abs(high)))
    is_within = bool(size.search.choices) or size.low < value.value < size.high
    return min(low * high, value.low * value.high) > 0.0 and ends[1] <= DECADE * ends[0] and is_within


def undetermined_notes(findings: Findings, names: Sequence[str], wording: Wording) -> list[str]:
    """Notes about effects of undetermined size, each with the experiment that would determine it."""
    notes = []
    for finding in findings.effects:
        if finding.name in names:
            size = EFFECTS[finding.name].size
            middle, interval = value_words(finding.parameters[size.name], size.name, finding.name, wording)
            notes.append(
                f"{finding.title} would explain a part, {finding.before:.3g} -> {finding.after:.3g} {findings.unit}, "
                f"but {label_of(size.name, size.unit)} is not determined by these recordings: {middle} ({interval}); "
                f"record {EFFECTS[finding.name].separate_by}"
            )
    return notes


def least_confident(result: Search, findings: Findings, highest: Mapping[str, float]) -> list[str]:
    """The least confident effect, if its confidence is too low to name it; empty if there is none.

    A removed effect may have explained a part of another one, whose confidence then falls. Therefore the highest
    confidence that each effect has had decides, unless the present one is near zero.
    """
    named = [f for f in findings.effects if f.name in result.names]
    if contradicted := [f for f in named if f.confidence < CONTRADICTED]:
        return [min(contradicted, key=lambda finding: finding.confidence).name]
    doubtful = (f for f in named if highest[f.name] < LEAST_CONFIDENCE)
    weak = [f for f in doubtful if f.after**2 > HALVED_ERROR * f.before**2 or highest[f.name] < NEVER_NAMED]
    return [min(weak, key=lambda finding: finding.confidence).name] if weak else []


def is_required(with_effect: Findings, without_effect: Findings) -> bool:
    """Whether the recordings are explained with an effect and not without it."""
    return with_effect.verdict == "explained" and without_effect.verdict not in ("explained", "matches")


def rejection_notes(findings: Findings, rejected: Sequence[str]) -> list[str]:
    """Notes about effects that lower the error and are not named."""
    return [
        f"{finding.name} would explain a part, {finding.before:.3g} -> {finding.after:.3g} {findings.unit}, but is not "
        f"named: confidence {confidence_words(finding.confidence)}"
        for finding in findings.effects
        if finding.name in rejected and finding.confidence < LEAST_CONFIDENCE and finding.after < finding.before
    ]
