"""Verdict of a history in words: each change with its values and its dates."""

from collections.abc import Sequence
from datetime import datetime

from piezod.diagnose.findings import Value
from piezod.diagnose.verdict.words import NO_BREAK, PER, VOLTS, Wording, listed, rounded, unit_words, value_words
from piezod.effects import EFFECTS
from piezod.history.changes import EffectChange, ParameterChange
from piezod.history.parameters import Key
from piezod.history.timeline import Step, Timeline
from piezod.history.trends import Trend
from piezod.model import Model
from piezod.model.parameters import BASE

MONTHS = (
    "January", "February", "March", "April", "May", "June", "July", "August", "September", "October", "November",
    "December",
)  # fmt: skip


def verdict_of(timeline: Timeline, trends: Sequence[Trend] = ()) -> str:
    """Changes from model to model in one line, in their order, then slow changes; kept parameters are summed up."""
    steps = timeline.steps
    if len(steps) == 1 and not trends:
        return "one model, nothing to compare it with"
    wording = wording_of(steps[-1].entry.model)
    clauses = [clause for step in steps for clause in step_clauses(step)]
    clauses += [trend_words(trend, wording) for trend in trends]
    if not clauses:
        period = between(steps[0].entry.date, steps[-1].entry.date)
        return f"nothing changed in {len(steps)} models {period}; all parameters kept"
    return "; ".join([*clauses, "all else kept"])


def step_clauses(step: Step) -> list[str]:
    """Clauses on the changes of a model since its reference, each with its dates."""
    if step.reference is None:
        return []
    period = between(step.reference.date, step.entry.date)
    wording = wording_of(step.entry.model)
    return [f"{change_words(change, wording)} {period}" for change in step.changes if change.status != "kept"]


def trend_words(trend: Trend, wording: Wording = VOLTS) -> str:
    """Clause on a slow change, with its dates and its number of recordings."""
    change = ParameterChange(trend.key, trend.before, trend.after, None, changed=True)
    moved = _moved(change, _title(trend.key.effect), wording, named=True, how=" slowly")
    return f"{moved} {between(trend.first, trend.last)} ({trend.count} recordings)"


def wording_of(model: Model) -> Wording:
    """Units of a model for texts."""
    return Wording(model.input.unit, model.output.unit)


def change_words(change: EffectChange, wording: Wording = VOLTS) -> str:
    """Clause on a changed, new or absent effect, without dates."""
    title = _title(change.name)
    shown = [parameter for parameter in change.parameters if parameter.changed]
    if change.status == "changed" and shown:
        return listed(
            [_moved(parameter, title, wording, named=parameter is not change.parameters[0]) for parameter in shown[:2]]
        )
    first = next(iter(change.parameters), None)
    if change.status == "gone":
        was = "" if first is None or first.before is None else f" (was {number(first.key, first.before, wording)})"
        return f"{title} went{was}"
    if change.status == "new":
        now = "" if first is None or first.after is None else f" ({number(first.key, first.after, wording)})"
        return f"{title} appeared{now}"
    return f"{title} changed"


def number(key: Key, value: Value, wording: Wording = VOLTS) -> str:
    """Value with unit and label, without its interval: 1.27 % per decade."""
    figure, unit = _figure(key, value, wording)
    return f"{figure} {unit}".rstrip()


def interval(key: Key, value: Value, wording: Wording = VOLTS) -> tuple[str, str]:
    """Value with unit, and its interval; the interval is empty where the model states none."""
    if key.effect != BASE:
        middle, ends = value_words(value, key.parameter, key.effect, wording)
        return middle.replace(NO_BREAK, " "), ends.replace(NO_BREAK, " ")
    unit = "/".join(map(unit_words, value.unit.split("/")))
    if value.high <= value.low:
        return f"{rounded(value.value, 4)} {unit}", ""
    return f"{rounded(value.value, 4)} {unit}", f"{rounded(value.low, 4)} to {rounded(value.high, 4)}"


def interval_text(key: Key, value: Value, model: Model) -> str:
    """Value with unit, and its interval in parentheses if the model states one."""
    middle, ends = interval(key, value, wording_of(model))
    return f"{middle} ({ends})" if ends else middle


def between(first: datetime, second: datetime) -> str:
    """Period between two dates in UTC, as short as it is unambiguous: between 12 and 19 March."""
    first, second = min(first, second), max(first, second)
    if first.date() == second.date():
        on = f"on {_day(first)}"
        times = f"{first:%H:%M}", f"{second:%H:%M}"
        return f"at {times[0]} {on}" if times[0] == times[1] else f"between {times[0]} and {times[1]} {on}"
    if first.year != second.year:
        return f"between {_day(first)} {first.year} and {_day(second)} {second.year}"
    if first.month == second.month:
        return f"between {first.day} and {_day(second)}"
    return f"between {_day(first)} and {_day(second)}"


def _title(name: str) -> str:
    """Title of an effect or of the base, by its name."""
    return "the stack" if name == BASE else EFFECTS[name].title if name in EFFECTS else name.replace("_", " ")


def _day(date: datetime) -> str:
    return f"{date.day} {MONTHS[date.month - 1]}"


def _moved(change: ParameterChange, title: str, wording: Wording, *, named: bool, how: str = "") -> str:
    """Clause on a parameter with its old and new value."""
    assert change.before is not None
    assert change.after is not None
    before, unit_before = _figure(change.key, change.before, wording)
    after, unit = _figure(change.key, change.after, wording)
    moved = "grew" if abs(change.after.value) > abs(change.before.value) else "fell"
    label = change.key.label(change.after.unit)
    name = f"{label} of {title}" if (named or change.key.effect == BASE) and not label.startswith(PER) else title
    old = before if unit_before == unit else f"{before} {unit_before}"
    return f"{name} {moved}{how} from {old} to {after} {unit}".rstrip()


def _figure(key: Key, value: Value, wording: Wording) -> tuple[str, str]:
    """Number, and unit with a label that follows it, such as "% per decade"."""
    figure, _, unit = interval(key, value, wording)[0].partition(" ")
    label = key.label(value.unit)
    return figure, f"{unit} {label}" if label.startswith(PER) else unit
