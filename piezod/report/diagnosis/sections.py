"""Text of a diagnosis page as HTML: verdict, signal chain, tables, and a card for each effect."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from piezod.diagnose.findings import Finding, Findings, Place
from piezod.diagnose.verdict.words import (
    Wording,
    confidence_words,
    label_of,
    percent,
    place_words,
    rounded,
    unit_words,
    value_words,
)
from piezod.effects import EFFECTS, Location
from piezod.estimation.recordings.series import Series
from piezod.report.diagnosis import wording as words

MOST_PLACES_LINE, MOST_PLACES_TABLE = 3, 6


def verdict_html(findings: Findings) -> str:
    """Verdict in a word, headline, and fall of the error."""
    return (
        f"<header><span class='chip {findings.verdict}'>{findings.verdict.replace('_', ' ')}</span>"
        f"<h1>{escape(words.headline(findings))}</h1><p class='lead'>{escape(words.lead(findings))}</p></header>"
    )


def chain_html(findings: Findings) -> str:
    """Signal chain, with each effect at its location."""
    boxes = []
    for location, name in words.LOCATIONS.items():
        effects = [effect for effect in findings.effects if EFFECTS[effect.name].location == location]
        marks = {"new": "", "changed": " changed", "gone": " gone"}
        titles = [f"{effect.title}{marks[effect.status]}" for effect in effects]
        titles += ["stack changed"] if findings.base.changed and location == Location.STACK else []
        unchanged = [EFFECTS[old.name].title for old in findings.kept if EFFECTS[old.name].location == location]
        inside = "".join(f"<b>{escape(title)}</b>" for title in titles)
        inside += "".join(f"<i>{escape(title)} kept</i>" for title in unchanged)
        boxes.append(
            f"<li class='{'hit' if titles else ''}'><span>{name}</span>{inside or '<i>nothing found</i>'}</li>"
        )
    return f"<ol class='chain' aria-label='signal chain from command to reading'>{''.join(boxes)}</ol>"


def effects_html(findings: Findings, wording: Wording) -> str:
    """Table of the effects, then the places in which the model is wrong, and the remaining error.

    Parameters
    ----------
    findings, wording
        Result of the diagnosis; units and names of the recordings.
    """
    remains = f"<p><b>What remains:</b> {escape(words.remaining_error(findings)[-1])}</p>"
    if not findings.effects:
        not_tested = "".join(f"<p>{escape(sentence)}</p>" for sentence in words.not_tested(findings))
        return remains + _places_table(findings, wording) + not_tested
    unit = unit_words(findings.unit)
    header = [
        "effect",
        "parameter (95\u00a0% interval)",
        "confidence",
        f"error without → with it [{unit}]",
        "compensator",
    ]
    head = "".join(f"<th>{escape(label)}</th>" for label in header)
    rows = "".join(_effect_row(effect, findings, header, wording) for effect in findings.effects)
    below = _places_line(findings, wording) + remains
    return f"<table class='effects'><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{below}"


def _places_line(findings: Findings, wording: Wording) -> str:
    """Places in which the given model is wrong, the largest on each axis, in a line."""
    largest = words.largest_places(findings.where, MOST_PLACES_LINE)
    text = "; ".join(words.place_with_share(place, wording) for place in largest)
    heading = words.place_heading(findings)
    return f"<p class='where'><b>{heading}</b> (share of the error): {escape(text)}</p>" if text else ""


def _places_table(findings: Findings, wording: Wording) -> str:
    """Places in which the given model is wrong, the largest on each axis, in a table."""
    places = words.largest_places(findings.where, MOST_PLACES_TABLE)
    if not places:
        return "<p>No place in time, frequency, voltage, rate or history shows more than noise.</p>"
    rows = [[place_words(place, wording), percent(place.share), f"{place.p:.2g}"] for place in places]
    header = [words.place_heading(findings), "share of the error", "probability of a false alarm"]
    return table(header, rows, kind="places")


def card_html(finding: Finding, findings: Findings, wording: Wording) -> str:
    """Card of an effect: equation, parameters, change of the error, and rivals.

    Parameters
    ----------
    findings, wording
        Result of the diagnosis; units and names of the recordings.
    """
    effect = EFFECTS[finding.name]
    fields = (("Forward", "equation"), ("Signature", "signature"), ("Location", "location"), ("Valid", "valid for"))
    items = "".join(
        f"<dt>{label}</dt><dd class='{field}'>{escape(words.docstring_field(effect, field))}</dd>"
        for field, label in fields
    )
    handling = words.HANDLINGS.get(finding.handling, finding.handling)
    facts = [
        ("confidence", confidence_words(finding.confidence)),
        ("error without → with it", _error_change(finding, findings)),
        ("when", words.since_given(finding, wording)),
        ("where", "; ".join(place_words(place, wording) for place in finding.where) or "everywhere"),
        ("compensator", handling + (f": {finding.why}" if finding.why else "")),
    ]
    items += "".join(f"<dt>{label}</dt><dd>{escape(text)}</dd>" for label, text in facts)
    return (
        f"<article class='card'><h3>{escape(finding.title)} <code>{finding.name}</code></h3>"
        f"<div class='two'><dl>{items}</dl><div>{_parameters_html(finding, wording)}{_rivals_html(finding)}</div></div>"
        "</article>"
    )


def held_out_html(findings: Findings, rows: Sequence[tuple[str, float, float]]) -> str:
    """Table of the errors of both models with the noise floor.

    Parameters
    ----------
    rows
        Name, rms error of the given and of the extended model, over each whole recording.
    """
    closed = "-" if findings.gap_closed is None else f"{100 * findings.gap_closed:.1f} %"
    unit = unit_words(findings.unit)
    first = [
        "simulate, all recordings",
        rounded(findings.before),
        rounded(findings.least),
        rounded(findings.floor),
        closed,
        f"{findings.nrmse_before:.2f} → {findings.nrmse_after:.2f} %",
    ]
    held_out = [(f"{Path(r.path).name}, held out from the fit", r.before, r.after) for r in findings.held_out]
    more = [[name, rounded(before), rounded(after), "", "", ""] for name, before, after in (*held_out, *rows)]
    header = [
        "",
        f"given model [{unit}]",
        f"{'extended model' if findings.refitted is None else 'refitted model'} [{unit}]",
        f"noise floor [{unit}]",
        "part of the error above the noise that is gone",
    ]
    return table([*header, "fit (NRMSE)"], [first, *more])


def remains_html(findings: Findings, places: Sequence[Place], wording: Wording) -> str:
    """The unexplained error, and the notes.

    Parameters
    ----------
    places
        Places in which the extended model is significantly wrong.
    wording
        Units and names of recordings for these places.
    """
    sentences = "".join(f"<li>{escape(sentence)}</li>" for sentence in words.remains(findings, places, wording))
    notes = "".join(f"<li>{escape(note)}</li>" for note in findings.notes)
    return f"<ul>{sentences}</ul>" + (f"<h3>Notes</h3><ul>{notes}</ul>" if notes else "")


def recordings_html(findings: Findings, series: Sequence[Series]) -> str:
    """Table of the files that were used, with their hashes.

    Parameters
    ----------
    series
        Series of all recordings; the last belong to the findings, in their order.
    """
    of_files = series[len(series) - len(findings.recordings) :]
    rows = [
        [
            str(file["path"]),
            "diagnosed" if record.role == "recording" else "used for identification",
            str(file["samples"]),
            f"{rounded(record.duration_s)} s at {rounded(1.0 / record.dt_s)} Hz",
            str(file["sha256"]),
        ]
        for file, record in zip(findings.recordings, of_files, strict=False)
    ]
    return table(["recording", "use", "samples", "duration and rate", "SHA-256"], rows, kind="files")


def table(header: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """Table with escaped cells. Each cell carries the label of its column, shown on narrow screens."""
    head = "".join(f"<th>{escape(label)}</th>" for label in header)
    body = "".join(
        "<tr>"
        + "".join(
            f"<td data-label='{escape(label)}'>{escape(cell)}</td>" for label, cell in zip(header, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<table class='{kind}'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _effect_row(finding: Finding, findings: Findings, header: Sequence[str], wording: Wording) -> str:
    places = words.places_of(finding, wording)
    effect = (
        f"<b>{escape(finding.title)}</b><small>{escape(words.location(finding))}"
        f"{escape(': ' + places) if places else ''}</small>"
        f"<small>{escape(words.since_given(finding, wording))}</small>"
    )
    cells = [
        effect,
        _parameters_column(finding, wording),
        _confidence_html(finding),
        f"{escape(words.error_change(finding, findings.unit))}<small>noise {rounded(findings.floor)}</small>",
        escape(words.HANDLINGS.get(finding.handling, finding.handling)),
    ]
    inside = "".join(f"<td data-label='{escape(label)}'>{cell}</td>" for label, cell in zip(header, cells, strict=True))
    return f"<tr>{inside}</tr>"


def _parameters_column(finding: Finding, wording: Wording) -> str:
    """Parameters, without times that are already listed as places."""
    parts, effect = [], EFFECTS[finding.name]
    for name, value in finding.parameters.items():
        if finding.where and effect.parameter(name).instant:
            continue
        text, interval = value_words(value, name, finding.name, wording)
        label = escape(label_of(name, value.unit))
        small = f"<small>{escape(interval)}</small>" if interval else ""
        parts.append(f"<span class='parameter'>{label} <b>{escape(text)}</b>{small}</span>")
    return "".join(parts)


def _error_change(finding: Finding, findings: Findings) -> str:
    change = words.error_change(finding, findings.unit)
    return change if words.observed_directly(finding) else f"{change} (noise {rounded(findings.floor)})"


def _confidence_html(finding: Finding) -> str:
    percentage = f"{100 * finding.confidence:.0f}"
    near = "".join(f"<small>or {escape(title)}</small>" for title in words.near_rivals(finding))
    return (
        f"<span class='bar' role='img' aria-label='confidence {percentage} percent'>"
        f"<span style='width:{percentage}%'></span></span>{confidence_words(finding.confidence)}{near}"
    )


def _parameters_html(finding: Finding, wording: Wording) -> str:
    rows = [
        [label_of(name, value.unit), *value_words(value, name, finding.name, wording)]
        for name, value in finding.parameters.items()
    ]
    return table(["parameter", "value", "95 % interval"], rows)


def _rivals_html(finding: Finding) -> str:
    rivals = finding.rivals
    if words.observed_directly(finding):
        return "<p>Observed in the readings; nothing was fitted.</p>"
    if not rivals:
        return "<p>No other effect of the catalogue explains the recordings similarly well.</p>"
    rows = [[EFFECTS[rival.name].title, rounded(rival.separation, 2)] for rival in rivals]
    experiments = dict.fromkeys(rival.separate_by for rival in rivals if rival.separate_by)
    text = "".join(f"<p><b>To distinguish them:</b> {escape(experiment)}</p>" for experiment in experiments)
    return table(["rival: possible alternative", "difference of the predictions [times the noise]"], rows) + text
