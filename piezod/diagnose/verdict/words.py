"""Text of values, places and effects, for the terminal, findings.json and the report."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from piezod.diagnose.findings import Base, Finding, Place, UnchangedEffect, Unnamed, Unrecorded, Value
from piezod.effects import EFFECTS
from piezod.estimation.fit.linear_dynamics import dynamics_words

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
DRIVERS = {
    "command": "the command",
    "rate": "the rate of the command",
    "direction": "the direction of the command",
    "way": "the way since the last reversal",
    "stroke": "the last stroke",
    "reading": "the expected reading",
    "reading_rate": "the rate of the expected reading",
}
LOGARITHMIC = {"frequency_Hz", "history_s"}
MILLI = {"s": "ms"}  # unit of values below SMALL
SMALL = 0.1
PER_CENT = 100.0
DECADE = 10.0  # ratio of a range's ends above which each end has three digits
EQUAL = 1e-3  # relative difference below which two ends are printed as one value, except times
WIDE = 0.5  # relative width above which an interval does not limit the digits
HIGH, PROBABLE = 0.9, 0.6  # lowest confidence called high and medium; below the latter "perhaps" precedes the name
PER = "per "  # start of labels that follow the value: 1.27 % per decade
NO_BREAK = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True)
class Wording:
    """Units and names for the text of values and places.

    Parameters
    ----------
    command, output
        Units of the recordings, which the catalogue calls V and N.
    recordings
        Name of the recording of each place in time, if there are several recordings.
    """

    command: str
    output: str
    recordings: Mapping[Place, str] = field(default_factory=dict)

    def unit(self, catalogued: str) -> str:
        """Unit of the catalogue, such as `N s/V`, with the units of the recordings."""
        named = {"V": self.command, "N": self.output}
        parts = [[named.get(symbol, symbol) for symbol in part.split(" ")] for part in catalogued.split("/")]
        return "/".join(" ".join(unit_words(symbol) for symbol in part) for part in parts)


VOLTS = Wording("V", "N")


def unit_words(unit: str) -> str:
    """Printed form of a unit: µ for a leading u, °C for C."""
    if len(unit) == 2 and unit[0] == "u":
        return f"\N{MICRO SIGN}{unit[1]}"
    return "°C" if unit in {"C", "degC"} else unit


def rounded(value: float, digits: int = 3) -> str:
    """Number with this many significant digits; as a power of ten only if very small or large."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    decimals = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
    if not -3 <= math.floor(math.log10(abs(value))) <= 6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{decimals}f}"


def percent(share: float) -> str:
    """Share in per cent, in whole numbers except near 100 %."""
    if share < 0.01:
        return "less than 1 %"
    return f"{100.0 * share:.1f} %" if 0.99 <= share < 0.9995 else f"{100.0 * share:.0f} %"


def label_of(name: str, unit: str) -> str:
    """Name of a parameter without its unit."""
    ending = "_" + unit.replace("/", "_per_").replace(" ", "_")
    return name.removesuffix(ending).replace("_", " ")


def value_words(value: Value, name: str, effect: str, wording: Wording = VOLTS) -> tuple[str, str]:
    """Value with unit, and its interval (empty for an exact value).

    The width of the interval determines the number of digits. A share (unit 1) is printed in per cent.
    """
    unit, factor = (" %", PER_CENT) if value.unit == "1" else (f" {wording.unit(value.unit)}", 1.0)
    if value.unit in MILLI and max(abs(value.value), value.high) < SMALL:
        unit, factor = f" {MILLI[value.unit]}", 1000.0
    unit = unit.replace(" ", NO_BREAK)
    middle, low, high = (factor * number for number in (value.value, value.low, value.high))
    if high <= low:
        return f"{rounded(middle, 4)}{unit}", ""
    if undetermined(value, name, effect):
        return f"{rounded(middle)}{unit}", "not determined by these recordings"
    decimals = max(1 - math.floor(math.log10(high - low)), 0)
    if high - low > WIDE * abs(middle) or decimals > 6:
        ends = rounded(low), rounded(high)
        if ends[0] == ends[1]:
            return f"{rounded(middle, 4)}{unit}", ""
        return f"{rounded(middle)}{unit}", " to ".join(ends)
    return f"{middle:.{decimals}f}{unit}", f"{low:.{decimals}f} to {high:.{decimals}f}"


def undetermined(value: Value, name: str, effect: str) -> bool:
    """Whether an interval spans the whole range of its parameter."""
    parameter = next((known for known in EFFECTS[effect].parameters if known.name == name), None)
    return parameter is not None and value.low <= parameter.low and value.high >= parameter.high


def place_words(place: Place, wording: Wording = VOLTS) -> str:
    """Text of a place, such as "time 53.8 to 57.8 s"."""
    if place.axis == "direction":
        return "rising and falling differ"
    name, unit = AXES.get(place.axis, (place.axis, ""))
    unit = wording.unit(unit)
    within = f" of {wording.recordings[place]}" if place in wording.recordings else ""
    narrow = EQUAL if place.axis != "time_s" else 1e-9
    if place.high - place.low <= narrow * max(abs(place.high), 1e-300):
        return f"{name} {rounded(place.low, 4)} {unit}{within}"
    if place.axis in LOGARITHMIC:
        return f"{name} {rounded(place.low)} to {rounded(place.high)} {unit}{within}"
    return f"{name} {_range_text(place.low, place.high)} {unit}{within}"


def _confidence_level(confidence: float) -> str:
    """Name of the level of a confidence from 0 to 1: `high`, `medium` or `low`."""
    if confidence >= HIGH:
        return "high"
    return "medium" if confidence >= PROBABLE else "low"


def confidence_words(confidence: float) -> str:
    """Confidence in per cent, with its level, for pages, terminal and notes.

    Parameters
    ----------
    confidence
        Confidence of a finding, 0 to 1.
    """
    return f"{100.0 * confidence:.0f} % ({_confidence_level(confidence)})"


def hedged(finding: Finding) -> str:
    """Title of an effect, after "perhaps" if its confidence is low."""
    return finding.title if finding.confidence >= PROBABLE else f"perhaps {finding.title}"


def effect_words(finding: Finding, wording: Wording = VOLTS) -> str:
    """Clause about an effect: title, first parameter and place."""
    if finding.status != "new":
        return change_words(finding, wording)
    text = hedged(finding)
    for name, value in list(finding.parameters.items())[:1]:
        middle, interval = _plain_words(value, name, finding.name, wording)
        label = label_of(name, value.unit)
        number = f"{middle} {label}" if label.startswith(PER) else f"{label} {middle}"
        text += f", {number}" + (f" ({interval})" if interval else "")
    return text + (f", seen at {place_words(finding.where[0], wording)}" if finding.where else "")


def change_words(finding: Finding, wording: Wording = VOLTS) -> str:
    """Clause about a changed or absent effect of the given model."""
    title = hedged(finding)
    name, value = next(iter(finding.parameters.items()))
    was = finding.was.get(name, value)
    before, now = (_number(known, name, finding.name, wording) for known in (was, value))
    if finding.status == "gone":
        return f"{title} is gone, was {before}"
    moved = "grew" if abs(value.value) > abs(was.value) else "fell"
    equal = abs(value.value - was.value) < EQUAL * abs(was.value)
    return f"{title} {'changed its shape' if equal else moved} from {before} to {now}"


def _number(value: Value, name: str, effect: str, wording: Wording) -> str:
    """Value with label and interval."""
    middle, interval = _plain_words(value, name, effect, wording)
    label = label_of(name, value.unit)
    number = f"{middle} {label}" if label.startswith(PER) else middle
    return number + (f" ({interval})" if interval else "")


def _plain_words(value: Value, name: str, effect: str, wording: Wording) -> tuple[str, str]:
    """Value and interval as in `value_words`, with plain spaces."""
    middle, interval = value_words(value, name, effect, wording)
    return middle.replace(NO_BREAK, " "), interval.replace(NO_BREAK, " ")


def base_words(base: Base) -> str:
    """Clause about a changed stack: gain and width of the loops."""
    if base.gain is None and base.loops is None:
        return "the stack itself has changed: loops of another shape"
    parts = []
    for label, value in (("gain", base.gain), ("loops", base.loops)):
        if value is None:
            parts.append(f"{label} as before")
        else:
            middle, low, high = (f"{PER_CENT * (factor - 1.0):+.1f}" for factor in (value.value, value.low, value.high))
            parts.append(f"{label} {middle} % ({low} to {high})")
    return f"the stack itself has changed: {', '.join(parts)}"


def unchanged_words(effects: Sequence[UnchangedEffect]) -> str:
    """Clause about unchanged effects of the given model; empty if there is none."""
    clauses = []
    for seen, word in ((True, "kept"), (False, "not seen")):
        titles = [EFFECTS[effect.name].title for effect in effects if effect.seen == seen]
        clauses += [f"{listed(titles)} {word}"] if titles else []
    return "; ".join(clauses)


def law_words(law: Unnamed) -> str:
    """Clause about an unnamed law: drivers, memory, modes and formula."""
    if law.linear:
        return f"linear dynamics without a name: {dynamics_words(law.modes, law.memories_s)}"
    drivers = listed([DRIVERS[name] for name in law.drivers])
    if not law.memories_s:
        memory = "without memory"
    else:
        low, high = law.memories_s
        memory = f"memory {rounded(low)} s" if low == high else f"memory {rounded(low)} to {rounded(high)} s"
    form = "gain that depends on" if law.gain else "law of"
    formula = f", nearly {law.formula}" if law.formula else ""
    return f"an unnamed {form} {drivers}, {memory}{formula}"


def unrecorded_words(unrecorded: Unrecorded, unit: str) -> str:
    """Clause about an unrecorded input: size and duration."""
    size = f"a gain of {percent(unrecorded.size)} rms" if unrecorded.gain else f"{rounded(unrecorded.size)} {unit} rms"
    duration = f"keeps its value for about {rounded(unrecorded.keeps_s, 2)} s"
    return f"what is left follows no function of the drive: an input that is not recorded, {size}, which {duration}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """Enumeration such as "one, two and three"."""
    return f" {last} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _range_text(low: float, high: float) -> str:
    """Range whose width determines the number of digits."""
    width = high - low
    decimals = max(1 - math.floor(math.log10(width)), 0) if width > 0.0 else 3
    if decimals > 6 or max(abs(low), abs(high)) >= 1e7:
        return f"{low:.3g} to {high:.3g}"
    if low > 0.0 and high > DECADE * low:
        return " to ".join(f"{float(f'{end:.3g}'):g}" for end in (low, high))
    return " to ".join("0" if end == 0.0 else f"{end:.{decimals}f}" for end in (low, high))
