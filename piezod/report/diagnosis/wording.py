"""Sentences of a diagnosis page: headline, fall of the error, and the unexplained error."""

from collections.abc import Sequence

from piezod.diagnose.findings import Finding, Findings, Place, Unnamed
from piezod.diagnose.verdict.words import (
    Wording,
    base_words,
    change_words,
    hedged,
    law_words,
    listed,
    percent,
    place_words,
    rounded,
    unchanged_words,
    unit_words,
    unrecorded_words,
)
from piezod.effects import EFFECTS, Effect, Location

LOCATIONS = {location: location.name.lower().replace("_", " ") for location in Location}
SCOPES = {
    "already": "present when the model was identified",
    "since": "appeared after the model was identified",
    "once": "happened once, in one recording",
}
HANDLINGS = {"refused": "cannot be compensated"}  # other handlings are shown by their names
FLOORS = {
    "quiet": "measured while the command is constant",
    "repeats": "from repeated periods of the excitation",
    "unknown": "an upper bound: the part that no flexible model explains",
}
MOST_PLACES = 2  # listed places of an effect; the others are counted
NEAR = 0.15  # rivals whose predictions differ by less are hardly distinguishable [rms of the noise]


def headline(findings: Findings) -> str:
    """Verdict as a title."""
    titles = _missing(findings)
    matches = "these recordings do not show what causes the rest" if findings.above_noise else "no effect is missing"
    return {
        "matches": f"The model matches the recordings: {matches}",
        "explained": titles,
        "partly_explained": f"{titles}, and an unknown effect",
        "unexplained": "The model lacks an effect that is not in the catalogue",
        "not_testable": "These recordings cannot show what the model lacks"
        if findings.noise_is_known
        else "No effect is found, and the noise is unknown",
    }[findings.verdict]


def _missing(findings: Findings) -> str:
    """New, changed and absent effects."""
    parts = []
    for status, start in (("new", "missing in the model"), ("changed", "changed"), ("gone", "gone")):
        titles = listed([hedged(finding) for finding in findings.effects if finding.status == status])
        parts += [f"{start}: {titles}"] if titles else []
    sentence = "; ".join([*parts, *([base_words(findings.base)] if findings.base.changed else [])])
    return sentence[:1].upper() + sentence[1:]


def lead(findings: Findings) -> str:
    """Fall of the error, compared with the noise."""
    unit = unit_words(findings.unit)
    known = "noise floor" if findings.noise_is_known else "noise unknown, at most"
    floor = f"{known} {rounded(findings.floor)} {unit} ({FLOORS.get(findings.floor_from, findings.floor_from)})"
    before = f"Error of the simulation: {rounded(findings.before)} {unit}"
    unchanged = unchanged_words(findings.kept)
    unchanged = f" Of the given model: {unchanged}." if unchanged else ""
    if findings.after == findings.before:
        refit = f", {rounded(findings.least)} {unit} after a refit" if findings.least < findings.before else ""
        return f"{before}{refit}; {floor}.{unchanged}"
    refitted = " with hysteresis and sampling refitted" if findings.refitted is not None else ""
    fall = f"{before} → {rounded(findings.after)} {unit}{refitted}; {floor}"
    closed = findings.gap_closed
    if closed is not None:
        fall += f". {percent(closed)} of the error above the noise is {'described' if findings.law else 'explained'}"
    law = f", with {law_words(findings.law)}" if findings.law else ""
    return f"{fall}{law}.{unchanged}"


def since_given(finding: Finding, wording: Wording) -> str:
    """Change of an effect of the given model, or the time at which a new effect appeared."""
    return SCOPES[finding.scope] if finding.status == "new" else change_words(finding, wording)


def location(finding: Finding) -> str:
    """Location of an effect in the signal chain."""
    return LOCATIONS[EFFECTS[finding.name].location]


def places_of(finding: Finding, wording: Wording) -> str:
    """First places of an effect, and the number of further places; empty if the effect acts everywhere.

    Parameters
    ----------
    finding, wording
        Finding of the effect; units and names of the recordings.
    """
    places = [place_words(place, wording) for place in finding.where[:MOST_PLACES]]
    more = len(finding.where) - MOST_PLACES
    return "; ".join([*places, f"{more} more"] if more > 0 else places)


def largest_places(places: Sequence[Place], most: int) -> list[Place]:
    """Largest place on each axis, in descending order of their share of the error."""
    of_axis: dict[str, Place] = {}
    for place in sorted(places, key=lambda place: -place.share):
        of_axis.setdefault(place.axis, place)
    return list(of_axis.values())[:most]


def place_with_share(place: Place, wording: Wording) -> str:
    """Place with its share of the error, in parentheses.

    Parameters
    ----------
    place, wording
        Place of the diagnosis; units and names of the recordings.
    """
    return f"{place_words(place, wording)} ({percent(place.share)})"


def error_change(finding: Finding, unit: str) -> str:
    """Held-out errors without and with an effect.

    Parameters
    ----------
    finding, unit
        Finding of the effect; unit of the output.
    """
    if observed_directly(finding):
        return "observed directly, not fitted"
    return f"{rounded(finding.before)} → {rounded(finding.after)} {unit_words(unit)}"


def near_rivals(finding: Finding) -> list[str]:
    """Titles of effects that these recordings hardly distinguish from a finding."""
    return [EFFECTS[rival.name].title for rival in finding.rivals if rival.separation < NEAR]


def observed_directly(finding: Finding) -> bool:
    """Whether an effect was observed in the readings and not fitted."""
    return finding.before == finding.after


def place_heading(findings: Findings) -> str:
    """Heading of the places in the findings."""
    if findings.verdict == "matches":
        return "Small errors of the given model, attributed to no effect"
    return "Where the given model is wrong"


def law_sentence(law: Unnamed, findings: Findings) -> str:
    """Drivers of an unnamed law, and the fall of the held-out error.

    Parameters
    ----------
    law, findings
        The law, and the findings that hold it.
    """
    unit = unit_words(findings.unit)
    words = law_words(law)
    scope = (
        "It holds in the recordings of the identification too" if law.already else "It came since the identification"
    )
    return (
        f"{words[0].upper()}{words[1:]}: error on held-out data {rounded(law.before)} → {rounded(law.after)} {unit}. "
        f"{scope}. No effect of the catalogue has its shape, so this is a description and no cause. "
        "The extended model contains it."
    )


def remains(findings: Findings, places: Sequence[Place], wording: Wording) -> list[str]:
    """Sentences on the unexplained error.

    Parameters
    ----------
    places
        Places in which the extended model is significantly wrong.
    wording
        Units and names of recordings for these places.
    """
    where = "; ".join(place_with_share(place, wording) for place in largest_places(places, 4))
    return [
        *remaining_error(findings),
        *([f"Places of the remaining error: {where}."] if where else []),
        *_indistinguishable(findings.effects),
        *not_tested(findings),
        *(
            f"{finding.title.capitalize()}: {HANDLINGS.get(finding.handling, finding.handling)}: {finding.why}."
            for finding in findings.effects
            if finding.handling == "refused" and finding.why
        ),
    ]


def not_tested(findings: Findings) -> list[str]:
    """Effects that may be present, but that these recordings cannot show.

    Returns
    -------
    One sentence, or none.
    """
    titles = listed([EFFECTS[name].title for name in findings.not_testable])
    return [f"Not tested: {titles}. The recordings lack the rates, holds or levels that show them."] if titles else []


def docstring_field(effect: Effect, field: str) -> str:
    """One of the six fields of an effect's docstring, on one line.

    Parameters
    ----------
    effect, field
        Entry of the catalogue; "Forward", "Inverse", "Signature", "Location", "Valid" or "Source".
    """
    lines: list[str] = []
    for line in effect.docstring.splitlines():
        if line.startswith(f"{field} "):
            lines.append(line.removeprefix(field).strip())
        elif lines and line.startswith("  "):
            lines.append(line.strip())
        elif lines:
            break
    return " ".join(lines)


def remaining_error(findings: Findings) -> list[str]:
    """Remaining error compared with the noise, and the share of it that some model can explain.

    Returns
    -------
    Two sentences: the error, then its causes.
    """
    unit, share = unit_words(findings.unit), percent(findings.explainable)
    noise = f"{'' if findings.noise_is_known else 'unknown, at most '}{rounded(findings.floor)} {unit}"
    error = f"The remaining error is {rounded(findings.after)} {unit} rms; the noise is {noise}."
    if findings.verdict == "not_testable":
        if findings.noise_is_known:
            return [error, "The recordings do not excite the bench enough to show what is missing."]
        return [error, "The command neither rests nor repeats, so nothing shows whether this is noise."]
    if findings.unrecorded is not None:
        words = unrecorded_words(findings.unrecorded, unit)
        return [error, f"{words[0].upper()}{words[1:]}. Record beside the reading what else changes at the bench."]
    above = "More than noise remains. " if findings.above_noise else ""
    consequence = {
        "matches": "no effect is missing",
        "explained": "no further effect is missing",
        "partly_explained": "the effects found do not explain all of it",
        "unexplained": "an effect is missing, and the catalogue does not contain it",
    }[findings.verdict]
    flexible = f"A flexible model without physics could explain {share} of the remaining error"
    return [error, f"{above}{flexible}: {consequence}."]


def _indistinguishable(effects: Sequence[Finding]) -> list[str]:
    return [
        f"{finding.title.capitalize()} may instead be {listed(near_rivals(finding), 'or')}: in these recordings their "
        f"predictions differ by less than {NEAR:g} times the noise. "
        f"To distinguish them: {finding.rivals[0].separate_by}."
        for finding in effects
        if near_rivals(finding)
    ]
