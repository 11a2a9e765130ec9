"""What a diagnosis says on its page, in sentences: verdict, how far the error falls, what is left."""

from collections.abc import Sequence

from piezod.diagnose.findings import Finding, Findings, Place
from piezod.diagnose.words import Wording, listed, percent, place_words, rounded, unit_words
from piezod.effects import EFFECTS, Effect, Location

LOCATIONS = {
    Location.AMPLIFIER: "amplifier",
    Location.HYSTERESIS: "hysteresis",
    Location.STACK: "stack",
    Location.MECHANICS: "mechanics",
    Location.LOAD_CELL: "load cell",
    Location.ACQUISITION: "acquisition",
}
VERDICTS = {
    "matches": "matches",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unexplained": "unexplained",
    "not_testable": "not testable",
}
SCOPES = {
    "already": "already there when the model was identified",
    "since": "has come since the model was identified",
    "once": "happened once, in one recording",
}
HANDLINGS = {
    "compensated": "compensated",
    "corrected in the reading": "corrected in the reading",
    "refused": "cannot be compensated",
}
FLOORS = {
    "quiet": "from stretches in which the command rests",
    "repeats": "from repeats of the excitation",
    "spectrum": "from what no flexible model explains",
}
NEAR = 0.15  # noises in root mean square: what differs by less is hardly told apart
SURE, LIKELY = 0.9, 0.7  # confidences


def headline(findings: Findings) -> str:
    """The verdict as a title."""
    titles = listed([hedged(one) for one in findings.effects])
    return {
        "matches": "The model matches the recordings: "
        + ("nothing more can be told from them" if findings.above_noise else "nothing is missing"),
        "explained": f"Left out by the model: {titles}",
        "partly_explained": f"Left out by the model: {titles}, and something unknown besides",
        "unexplained": "Something is missing that no known effect explains",
        "not_testable": "These recordings cannot tell what the model leaves out",
    }[findings.verdict]


def lead(findings: Findings) -> str:
    """How far the error falls, against the noise."""
    unit = unit_words(findings.unit)
    floor = f"noise floor {rounded(findings.floor)} {unit} ({FLOORS.get(findings.floor_from, findings.floor_from)})"
    if findings.refitted is not None:
        refitted = f", {rounded(findings.left)} {unit} once refitted" if findings.left < findings.before else ""
        return f"Error on data left out: {rounded(findings.before)} {unit}{refitted}; {floor}."
    fall = f"Error on data left out: {rounded(findings.before)} {unit} → {rounded(findings.after)} {unit}; {floor}"
    closed = findings.gap_closed
    return f"{fall}; {percent(closed)} of what is above the noise is explained." if closed is not None else f"{fall}."


def sureness(confidence: float) -> str:
    """A confidence in a word."""
    if confidence >= SURE:
        return "sure"
    return "likely" if confidence >= LIKELY else "uncertain"


def hedged(finding: Finding) -> str:
    """Title of an effect, with a perhaps before one that is uncertain."""
    return finding.title if finding.confidence >= LIKELY else f"perhaps {finding.title}"


def location_words(finding: Finding) -> str:
    """Location of an effect in the signal chain."""
    return LOCATIONS[_effect(finding.name).location]


def places_words(finding: Finding, wording: Wording, most: int = 2) -> str:
    """Places of an effect in a few words; empty where it acts everywhere."""
    said = [place_words(one, wording) for one in finding.where[:most]]
    more = len(finding.where) - most
    return "; ".join([*said, f"{more} more"] if more > 0 else said)


def first_places(places: Sequence[Place], most: int) -> list[Place]:
    """The largest place on each axis, the largest first."""
    of_axis: dict[str, Place] = {}
    for place in sorted(places, key=lambda one: -one.share):
        of_axis.setdefault(place.axis, place)
    return list(of_axis.values())[:most]


def gain_words(finding: Finding, unit: str) -> str:
    """Error without an effect and with it."""
    if read_off(finding):
        return "read off the data, no fit"
    return f"{rounded(finding.before)} → {rounded(finding.after)} {unit_words(unit)}"


def near_rivals(finding: Finding) -> list[str]:
    """What an effect is hardly told apart from in these recordings."""
    return [_effect(one.name).title for one in finding.rivals if one.separation < NEAR]


def read_off(finding: Finding) -> bool:
    """Whether an effect was seen in the readings and not fitted."""
    return finding.before == finding.after


def place_heading(findings: Findings) -> str:
    """What the places of a diagnosis are, as a title."""
    if findings.verdict == "matches":
        return "Small remainders of the given model, none worth a name"
    return "Where the given model is wrong"


def remains(findings: Findings, left: Sequence[Place], wording: Wording) -> list[str]:
    """What remains unexplained, said plainly.

    Parameters
    ----------
    findings
        Of the diagnosis.
    left
        Where the residual of the extended model is more than noise.
    wording
        For these places.
    """
    sits = "; ".join(f"{place_words(one, wording)} ({percent(one.share)})" for one in first_places(left, 4))
    return [
        *left_over(findings),
        *([f"What is left sits at {sits}."] if sits else []),
        *_not_told_apart(findings.effects),
        *not_seen(findings),
        *(
            f"{one.title.capitalize()}: {HANDLINGS.get(one.handling, one.handling)}: {one.why}."
            for one in findings.effects
            if one.handling == "refused" and one.why
        ),
    ]


def not_seen(findings: Findings) -> list[str]:
    """Effects that might be there unseen."""
    titles = listed([_effect(name).title for name in findings.not_testable])
    lacks = "these recordings lack the rates, holds or levels that would show it"
    return [f"Nothing is said about {titles}: {lacks}."] if titles else []


def docstring_field(effect: Effect, field: str) -> str:
    """One of the six fields of an effect's docstring, on one line."""
    found: list[str] = []
    for line in effect.docstring.splitlines():
        if line.startswith(f"{field} "):
            found.append(line.removeprefix(field).strip())
        elif found and line.startswith("  "):
            found.append(line.strip())
        elif found:
            break
    return " ".join(found)


def left_over(findings: Findings) -> list[str]:
    """Error that is left against the noise, and how much of it anything could explain."""
    unit, share = unit_words(findings.unit), percent(findings.explainable)
    error = f"{rounded(findings.left)} {unit} rms are left on data left out; noise: {rounded(findings.floor)} {unit}."
    flexible = f"A flexible model without physics could explain {share} of what is left"
    if findings.above_noise:
        flexible = f"More than noise is left. {flexible}"
    if findings.verdict == "matches":
        return [error, f"{flexible}: nothing worth a name."]
    if findings.verdict == "explained":
        return [error, f"{flexible}: nothing else is worth a name."]
    if findings.verdict == "partly_explained":
        return [error, f"{flexible}: the effects found are not all of it."]
    if findings.verdict == "unexplained":
        return [error, f"{flexible}: there is something, and no effect of the catalogue is it."]
    return [error, "The recordings do not excite the bench enough to tell what is missing."]


def _not_told_apart(effects: Sequence[Finding]) -> list[str]:
    return [
        f"{one.title.capitalize()} might be {listed(near_rivals(one), 'or')}: in these recordings they differ by less "
        f"than {NEAR:g} of the noise. To tell them apart: {one.rivals[0].separate_by}."
        for one in effects
        if near_rivals(one)
    ]


def _effect(name: str) -> Effect:
    return EFFECTS[name]
