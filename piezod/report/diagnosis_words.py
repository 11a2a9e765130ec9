"""What a diagnosis says, in sentences and numbers for people: verdict, places, intervals, what is left."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from piezod.diagnose.findings import Finding, Findings, Place, Value
from piezod.effects import EFFECTS, Effect, Seat

SEATS = {
    Seat.AMPLIFIER: "amplifier",
    Seat.HYSTERESIS: "hysteresis",
    Seat.STACK: "stack",
    Seat.MECHANICS: "mechanics",
    Seat.LOAD_CELL: "load cell",
    Seat.ACQUISITION: "acquisition",
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
AXES = {
    "time_s": ("time", "s"),
    "frequency_Hz": ("frequency", "Hz"),
    "voltage_V": ("command", "V"),
    "rate_V_per_s": ("rate of the command", "V/s"),
    "force_N": ("output", "N"),
    "amplitude_V": ("way since the last reversal", "V"),
    "history_s": ("memory", "s"),
    "temperature_C": ("temperature", "°C"),
}
LOGARITHMIC = {"frequency_Hz", "history_s"}
NEAR = 0.15  # noises in root mean square: what differs by less is hardly told apart
MILLI = {"s": "ms"}  # units that are said in thousandths below SMALL
SMALL = 0.1
WIDE = 0.5  # of the value: an interval beyond it says nothing about digits


@dataclass(frozen=True)
class Wording:
    """What places are told with.

    Parameters
    ----------
    command, output
        Units.
    recordings
        Name of the recording that a place in time is in, where there are several.
    """

    command: str
    output: str
    recordings: Mapping[Place, str] = field(default_factory=dict)

    def unit_of(self, axis: str, otherwise: str) -> str:
        """Unit of an axis of places."""
        of = {"voltage_V": self.command, "amplitude_V": self.command, "rate_V_per_s": f"{self.command}/s"}
        return {**of, "force_N": self.output}.get(axis, otherwise)


def headline(findings: Findings) -> str:
    """The verdict as a title."""
    titles = _listed([one.title for one in findings.effects])
    return {
        "matches": "The model matches the recordings: nothing is missing",
        "explained": f"Left out by the model: {titles}",
        "partly_explained": f"Left out by the model: {titles}, and something unknown besides",
        "unexplained": "Something is missing that no known effect explains",
        "not_testable": "These recordings cannot tell what the model leaves out",
    }[findings.verdict]


def lead(findings: Findings) -> str:
    """How far the error falls, against the noise."""
    unit = findings.unit
    floor = f"noise floor {rounded(findings.floor)} {unit} ({FLOORS.get(findings.floor_from, findings.floor_from)})"
    if not findings.effects:
        return f"Error on data left out: {rounded(findings.before)} {unit}; {floor}."
    fall = f"Error on data left out: {rounded(findings.before)} {unit} → {rounded(findings.after)} {unit}; {floor}"
    closed = findings.gap_closed
    return f"{fall}; {percent(closed)} of the gap closed." if closed is not None else f"{fall}."


def sureness(confidence: float) -> str:
    """A confidence in a word."""
    if confidence >= 0.9:
        return "sure"
    return "likely" if confidence >= 0.7 else "uncertain"


def rounded(value: float, digits: int = 3) -> str:
    """Number with so many digits that matter, never as a power of ten where it can be read without."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    if not -3 <= math.floor(math.log10(abs(value))) <= 6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{decimals}f}"


def percent(share: float) -> str:
    """A part of a whole."""
    if share < 0.01:
        return "less than 1 %"
    return f"{100.0 * share:.1f} %" if 0.99 <= share < 0.9995 else f"{100.0 * share:.0f} %"


def label_of(name: str, unit: str) -> str:
    """A parameter's name without its unit."""
    ending = "_" + unit.replace("/", "_per_").replace(" ", "_")
    return name.removesuffix(ending).replace("_", " ")


def value_words(value: Value, name: str, effect: str) -> tuple[str, str]:
    """Value with unit, and its interval in words, with as many digits as the interval bears."""
    unit, factor = value.unit, 1.0
    if unit in MILLI and max(abs(value.value), value.high) < SMALL:
        unit, factor = MILLI[unit], 1000.0
    unit = "" if unit == "1" else "\u00a0" + unit.replace(" ", "\u00a0")
    middle, low, high = (factor * one for one in (value.value, value.low, value.high))
    if high <= low:
        return f"{rounded(middle, 4)}{unit}", ""
    if undetermined(value, name, effect):
        return f"{rounded(middle)}{unit}", "not determined by these recordings"
    decimals = max(1 - math.floor(math.log10(high - low)), 0)
    if high - low > WIDE * abs(middle) or decimals > 6:
        return f"{rounded(middle)}{unit}", f"{rounded(low)} to {rounded(high)}"
    return f"{middle:.{decimals}f}{unit}", f"{low:.{decimals}f} to {high:.{decimals}f}"


def undetermined(value: Value, name: str, effect: str) -> bool:
    """Whether an interval says nothing: it is all that a parameter can be."""
    parameter = next((one for one in _effect(effect).parameters if one.name == name), None)
    return parameter is not None and value.low <= parameter.low and value.high >= parameter.high


def seat_words(finding: Finding) -> str:
    """Where an effect sits in the signal chain."""
    return SEATS[_effect(finding.name).seat]


def place_words(place: Place, wording: Wording) -> str:
    """Where something is, as one would say it."""
    if place.axis == "direction":
        return "rising and falling differ"
    name, unit = AXES.get(place.axis, (place.axis, ""))
    unit = wording.unit_of(place.axis, unit)
    within = f" of {wording.recordings[place]}" if place in wording.recordings else ""
    if place.high - place.low <= 1e-9 * max(abs(place.high), 1e-300):
        return f"{name} {rounded(place.low, 4)} {unit}{within}"
    if place.axis in LOGARITHMIC:
        return f"{name} {rounded(place.low)} to {rounded(place.high)} {unit}{within}"
    return f"{name} {_between(place.low, place.high)} {unit}{within}"


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
    return f"{rounded(finding.before)} → {rounded(finding.after)} {unit}"


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
        *(
            f"{one.title.capitalize()}: {HANDLINGS.get(one.handling, one.handling)}: {one.why}."
            for one in findings.effects
            if one.handling == "refused" and one.why
        ),
    ]


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
    unit, share = findings.unit, percent(findings.explainable)
    error = f"{rounded(findings.after)} {unit} rms are left on data left out; noise: {rounded(findings.floor)} {unit}."
    flexible = f"A flexible model without physics could explain {share} of what is left"
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
        f"{one.title.capitalize()} might be {_listed(near_rivals(one), 'or')}: in these recordings they differ by less "
        f"than {NEAR:g} of the noise. To tell them apart: {one.rivals[0].separate_by}."
        for one in effects
        if near_rivals(one)
    ]


def _between(low: float, high: float) -> str:
    """A range with as many digits as its width bears."""
    width = high - low
    decimals = max(1 - math.floor(math.log10(width)), 0) if width > 0.0 else 3
    if decimals > 6 or max(abs(low), abs(high)) >= 1e7:
        return f"{low:.3g} to {high:.3g}"
    return f"{low:.{decimals}f} to {high:.{decimals}f}"


def _listed(words: Sequence[str], last: str = "and") -> str:
    return f" {last} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _effect(name: str) -> Effect:
    return EFFECTS[name]
