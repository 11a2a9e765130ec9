"""Values, places and effects in words: one wording for the terminal, findings.json and the page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from piezod.diagnose.findings import Base, Finding, Kept, Place, Unnamed, Unrecorded, Value
from piezod.effects import EFFECTS

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
MILLI = {"s": "ms"}  # units that are said in thousandths below SMALL
SMALL = 0.1
PER_CENT = 100.0
DECADE = 10.0  # ends farther apart keep three digits each
SAME = 1e-3  # of the value: ends nearer to each other are one, except in time
WIDE = 0.5  # of the value: an interval beyond it says nothing about digits
PROBABLE = 0.6  # confidence below which a name is said with a perhaps
PER = "per "  # a parameter so called is said behind its value: 1.27 % per decade
NO_BREAK = "\N{NO-BREAK SPACE}"


@dataclass(frozen=True)
class Wording:
    """What values and places are told with.

    Parameters
    ----------
    command, output
        Units, which the catalogue calls V and N.
    recordings
        Name of the recording that a place in time is in, where there are several.
    """

    command: str
    output: str
    recordings: Mapping[Place, str] = field(default_factory=dict)

    def unit(self, catalogued: str) -> str:
        """A unit of the catalogue, such as `N s/V`, in those of the recordings."""
        named = {"V": self.command, "N": self.output}
        parts = [[named.get(one, one) for one in part.split(" ")] for part in catalogued.split("/")]
        return "/".join(" ".join(unit_words(one) for one in part) for part in parts)


VOLTS = Wording("V", "N")


def unit_words(unit: str) -> str:
    """A unit as it is written: a leading u for micro where a unit follows, C for a temperature."""
    if len(unit) == 2 and unit[0] == "u":
        return f"\N{MICRO SIGN}{unit[1]}"
    return "°C" if unit in {"C", "degC"} else unit


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


def value_words(value: Value, name: str, effect: str, wording: Wording = VOLTS) -> tuple[str, str]:
    """Value with unit, and its interval in words, with as many digits as the interval bears; a unit of 1 in per cent.

    Parameters
    ----------
    value
        Of a parameter.
    name, effect
        The parameter's and the effect's, of the catalogue.
    wording
        Units of the recordings.
    """
    unit, factor = (" %", PER_CENT) if value.unit == "1" else (f" {wording.unit(value.unit)}", 1.0)
    if value.unit in MILLI and max(abs(value.value), value.high) < SMALL:
        unit, factor = f" {MILLI[value.unit]}", 1000.0
    unit = unit.replace(" ", NO_BREAK)
    middle, low, high = (factor * one for one in (value.value, value.low, value.high))
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
    """Whether an interval says nothing: it is all that a parameter can be."""
    parameter = next((one for one in EFFECTS[effect].parameters if one.name == name), None)
    return parameter is not None and value.low <= parameter.low and value.high >= parameter.high


def place_words(place: Place, wording: Wording = VOLTS) -> str:
    """Where something is, as one would say it."""
    if place.axis == "direction":
        return "rising and falling differ"
    name, unit = AXES.get(place.axis, (place.axis, ""))
    unit = wording.unit(unit)
    within = f" of {wording.recordings[place]}" if place in wording.recordings else ""
    narrow = SAME if place.axis != "time_s" else 1e-9
    if place.high - place.low <= narrow * max(abs(place.high), 1e-300):
        return f"{name} {rounded(place.low, 4)} {unit}{within}"
    if place.axis in LOGARITHMIC:
        return f"{name} {rounded(place.low)} to {rounded(place.high)} {unit}{within}"
    return f"{name} {_between(place.low, place.high)} {unit}{within}"


def hedged(finding: Finding) -> str:
    """Title of an effect, behind "perhaps" where it is not believed."""
    return finding.title if finding.confidence >= PROBABLE else f"perhaps {finding.title}"


def effect_words(finding: Finding, wording: Wording = VOLTS) -> str:
    """An effect with its first parameter and where it is seen: a part of the verdict's sentence."""
    if finding.status != "new":
        return change_words(finding, wording)
    said = hedged(finding)
    for name, value in list(finding.parameters.items())[:1]:
        middle, interval = (one.replace(NO_BREAK, " ") for one in value_words(value, name, finding.name, wording))
        label = label_of(name, value.unit)
        number = f"{middle} {label}" if label.startswith(PER) else f"{label} {middle}"
        said += f", {number}" + (f" ({interval})" if interval else "")
    return said + (f", seen at {place_words(finding.where[0], wording)}" if finding.where else "")


def change_words(finding: Finding, wording: Wording = VOLTS) -> str:
    """What has become of an effect of the given model: a part of the verdict's sentence."""
    title = hedged(finding)
    name, value = next(iter(finding.parameters.items()))
    was = finding.was.get(name, value)
    before, now = (_number(one, name, finding.name, wording) for one in (was, value))
    if finding.status == "gone":
        return f"{title} is gone, was {before}"
    moved = "grew" if abs(value.value) > abs(was.value) else "fell"
    same = abs(value.value - was.value) < SAME * abs(was.value)
    return f"{title} {'changed its shape' if same else moved} from {before} to {now}"


def _number(value: Value, name: str, effect: str, wording: Wording) -> str:
    """A value with its label and interval."""
    middle, interval = (one.replace(NO_BREAK, " ") for one in value_words(value, name, effect, wording))
    label = label_of(name, value.unit)
    number = f"{middle} {label}" if label.startswith(PER) else middle
    return number + (f" ({interval})" if interval else "")


def base_words(base: Base) -> str:
    """What has become of the stack itself: a part of the verdict's sentence."""
    if base.gain is None and base.loops is None:
        return "the stack itself has changed: loops of another shape"
    parts = []
    for label, value in (("gain", base.gain), ("loops", base.loops)):
        if value is None:
            parts.append(f"{label} as before")
        else:
            middle, low, high = (f"{PER_CENT * (one - 1.0):+.1f}" for one in (value.value, value.low, value.high))
            parts.append(f"{label} {middle} % ({low} to {high})")
    return f"the stack itself has changed: {', '.join(parts)}"


def kept_words(kept: Sequence[Kept]) -> str:
    """Effects of the given model that have not changed; empty: there is none."""
    said = []
    for seen, word in ((True, "kept"), (False, "not seen")):
        titles = [EFFECTS[one.name].title for one in kept if one.seen == seen]
        said += [f"{listed(titles)} {word}"] if titles else []
    return "; ".join(said)


def law_words(law: Unnamed) -> str:
    """An unnamed law with what it depends on: a part of the verdict's sentence."""
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
    """An input that is not recorded: a part of the verdict's sentence."""
    size = f"a gain of {percent(unrecorded.size)} rms" if unrecorded.gain else f"{rounded(unrecorded.size)} {unit} rms"
    kept = f"keeps its value for about {rounded(unrecorded.keeps_s, 2)} s"
    return f"what is left follows no function of the drive: an input that is not recorded, {size}, which {kept}"


def listed(words: Sequence[str], last: str = "and") -> str:
    """One, two and three."""
    return f" {last} ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)


def _between(low: float, high: float) -> str:
    """A range with as many digits as its width bears."""
    width = high - low
    decimals = max(1 - math.floor(math.log10(width)), 0) if width > 0.0 else 3
    if decimals > 6 or max(abs(low), abs(high)) >= 1e7:
        return f"{low:.3g} to {high:.3g}"
    if low > 0.0 and high > DECADE * low:
        return " to ".join(f"{float(f'{one:.3g}'):g}" for one in (low, high))
    return " to ".join("0" if one == 0.0 else f"{one:.{decimals}f}" for one in (low, high))
