"""The parts of a diagnosis page that are text: verdict, signal chain, tables, and a card for every effect."""

import html
from collections.abc import Sequence
from pathlib import Path

from piezod.diagnose.findings import Finding, Findings, Place
from piezod.diagnose.series import Series
from piezod.diagnose.words import Wording, label_of, percent, place_words, rounded, unit_words, value_words
from piezod.effects import EFFECTS
from piezod.report.diagnosis import wording as words

PLACES_SAID, PLACES_LISTED = 3, 6


def verdict_html(findings: Findings) -> str:
    """Title, verdict in one word, and how far the error falls."""
    return (
        f"<header><span class='chip {findings.verdict}'>{words.VERDICTS[findings.verdict]}</span>"
        f"<h1>{_escaped(words.headline(findings))}</h1><p class='lead'>{_escaped(words.lead(findings))}</p></header>"
    )


def chain_html(findings: Findings) -> str:
    """The signal chain with the effects at their locations."""
    boxes = []
    for location, name in words.LOCATIONS.items():
        here = [one for one in findings.effects if EFFECTS[one.name].location == location]
        inside = "".join(f"<b>{_escaped(one.title)}</b>" for one in here) or "<i>nothing found</i>"
        boxes.append(f"<li class='{'hit' if here else ''}'><span>{name}</span>{inside}</li>")
    return f"<ol class='chain' aria-label='signal chain from command to reading'>{''.join(boxes)}</ol>"


def effects_html(findings: Findings, wording: Wording) -> str:
    """The effects in one compact table, below it where the model is wrong and what remains."""
    remains = f"<p><b>What remains:</b> {_escaped(words.left_over(findings)[-1])}</p>"
    if not findings.effects:
        unseen = "".join(f"<p>{_escaped(one)}</p>" for one in words.not_seen(findings))
        return remains + _places_table(findings, wording) + unseen
    unit = unit_words(findings.unit)
    header = [
        "effect",
        "parameter (95\u00a0% interval)",
        "confidence",
        f"error without → with it [{unit}]",
        "compensator",
    ]
    head = "".join(f"<th>{_escaped(one)}</th>" for one in header)
    rows = "".join(_effect_row(one, findings, header, wording) for one in findings.effects)
    below = _places_line(findings, wording) + remains
    return f"<table class='effects'><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{below}"


def _places_line(findings: Findings, wording: Wording) -> str:
    """Where the given model is wrong, the largest part on each axis."""
    said = "; ".join(
        f"{place_words(one, wording)} ({percent(one.share)})" for one in words.first_places(findings.where, PLACES_SAID)
    )
    heading = words.place_heading(findings)
    return f"<p class='where'><b>{heading}</b> (part of the error): {_escaped(said)}</p>" if said else ""


def _places_table(findings: Findings, wording: Wording) -> str:
    """The same, as a table of more of them."""
    places = words.first_places(findings.where, PLACES_LISTED)
    if not places:
        return "<p>No place in time, frequency, voltage, rate or history shows more than noise.</p>"
    rows = [[place_words(one, wording), percent(one.share), f"{one.p:.2g}"] for one in places]
    return table([words.place_heading(findings), "part of the error", "chance of a false alarm"], rows, kind="places")


def card_html(finding: Finding, findings: Findings, wording: Wording) -> str:
    """An effect: its equation, its numbers, what it brings, and what else it might be."""
    effect = EFFECTS[finding.name]
    fields = (("Forward", "equation"), ("Signature", "seen by"), ("Location", "location"), ("Valid", "valid for"))
    told = "".join(
        f"<dt>{label}</dt><dd class='{field}'>{_escaped(words.docstring_field(effect, field))}</dd>"
        for field, label in fields
    )
    handling = words.HANDLINGS.get(finding.handling, finding.handling)
    facts = [
        ("confidence", f"{100 * finding.confidence:.0f} %, {words.sureness(finding.confidence)}"),
        ("error without it → with it", _gain(finding, findings)),
        ("when", words.SCOPES[finding.scope]),
        ("where", "; ".join(place_words(one, wording) for one in finding.where) or "everywhere"),
        ("compensator", handling + (f": {finding.why}" if finding.why else "")),
    ]
    told += "".join(f"<dt>{label}</dt><dd>{_escaped(text)}</dd>" for label, text in facts)
    return (
        f"<article class='card'><h3>{_escaped(finding.title)} <code>{finding.name}</code></h3>"
        f"<div class='two'><dl>{told}</dl><div>{_parameters_html(finding, wording)}{_rivals_html(finding)}</div></div>"
        "</article>"
    )


def held_out_html(findings: Findings, rows: Sequence[tuple[str, float, float]]) -> str:
    """Before and after beside the noise floor.

    Parameters
    ----------
    findings
        Of the diagnosis.
    rows
        Name and root mean square error of given and extended model, over each whole recording.
    """
    closed = "-" if findings.gap_closed is None else f"{100 * findings.gap_closed:.1f} %"
    unit = unit_words(findings.unit)
    first = [
        "data left out",
        rounded(findings.before),
        rounded(findings.left),
        rounded(findings.floor),
        closed,
        f"{findings.nrmse_before:.2f} → {findings.nrmse_after:.2f} %",
    ]
    apart = [
        (f"{Path(one.path).name}, held out: nothing was fitted to it", one.before, one.after)
        for one in findings.held_out
    ]
    more = [[name, rounded(before), rounded(after), "", "", ""] for name, before, after in (*apart, *rows)]
    header = [
        "",
        f"given model [{unit}]",
        f"{'with what was found' if findings.refitted is None else 'refitted'} [{unit}]",
        f"noise floor [{unit}]",
        "gap to the noise closed",
    ]
    return table([*header, "fit (NRMSE)"], [first, *more])


def remains_html(findings: Findings, left: Sequence[Place], wording: Wording) -> str:
    """What remains unexplained, and what was noticed on the way."""
    said = "".join(f"<li>{_escaped(one)}</li>" for one in words.remains(findings, left, wording))
    notes = "".join(f"<li>{_escaped(one)}</li>" for one in findings.notes)
    return f"<ul>{said}</ul>" + (f"<h3>Noticed on the way</h3><ul>{notes}</ul>" if notes else "")


def recordings_html(findings: Findings, series: Sequence[Series]) -> str:
    """Every file that was used, with its hash."""
    known = series[len(series) - len(findings.recordings) :]
    rows = [
        [
            str(one["path"]),
            "asked about" if made.role == "recording" else "the model was identified on it",
            str(one["samples"]),
            f"{rounded(made.duration_s)} s at {rounded(1.0 / made.dt_s)} Hz",
            str(one["sha256"]),
        ]
        for one, made in zip(findings.recordings, known, strict=False)
    ]
    return table(["recording", "", "samples", "", "SHA-256"], rows, kind="files")


def table(header: Sequence[str], rows: Sequence[Sequence[str]], kind: str = "") -> str:
    """A table whose cells know their column's name, for narrow screens."""
    head = "".join(f"<th>{_escaped(one)}</th>" for one in header)
    body = "".join(
        "<tr>"
        + "".join(
            f"<td data-label='{_escaped(label)}'>{_escaped(cell)}</td>" for label, cell in zip(header, row, strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<table class='{kind}'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _effect_row(finding: Finding, findings: Findings, header: Sequence[str], wording: Wording) -> str:
    places = words.places_words(finding, wording)
    what = (
        f"<b>{_escaped(finding.title)}</b><small>{_escaped(words.location_words(finding))}"
        f"{_escaped(': ' + places) if places else ''}</small><small>{_escaped(words.SCOPES[finding.scope])}</small>"
    )
    cells = [
        what,
        _numbers_html(finding, wording),
        _confidence_html(finding),
        f"{_escaped(words.gain_words(finding, findings.unit))}<small>noise {rounded(findings.floor)}</small>",
        _escaped(words.HANDLINGS.get(finding.handling, finding.handling)),
    ]
    inside = "".join(f"<td data-label='{_escaped(k)}'>{cell}</td>" for k, cell in zip(header, cells, strict=True))
    return f"<tr>{inside}</tr>"


def _numbers_html(finding: Finding, wording: Wording) -> str:
    """Parameters; instants are said as places already."""
    said, effect = [], EFFECTS[finding.name]
    for name, value in finding.parameters.items():
        if finding.where and effect.parameter(name).instant:
            continue
        middle, interval = value_words(value, name, finding.name, wording)
        label = _escaped(label_of(name, value.unit))
        within = f"<small>{_escaped(interval)}</small>" if interval else ""
        said.append(f"<span class='parameter'>{label} <b>{_escaped(middle)}</b>{within}</span>")
    return "".join(said)


def _gain(finding: Finding, findings: Findings) -> str:
    said = words.gain_words(finding, findings.unit)
    return said if words.read_off(finding) else f"{said} (noise {rounded(findings.floor)})"


def _confidence_html(finding: Finding) -> str:
    percent = f"{100 * finding.confidence:.0f}"
    near = "".join(f"<small>or {_escaped(one)}</small>" for one in words.near_rivals(finding))
    return (
        f"<span class='bar' role='img' aria-label='confidence {percent} percent'>"
        f"<span style='width:{percent}%'></span></span>{percent} % {words.sureness(finding.confidence)}{near}"
    )


def _parameters_html(finding: Finding, wording: Wording) -> str:
    rows = [
        [label_of(name, value.unit), *value_words(value, name, finding.name, wording)]
        for name, value in finding.parameters.items()
    ]
    return table(["parameter", "value", "95 % interval"], rows)


def _rivals_html(finding: Finding) -> str:
    rivals = finding.rivals
    if words.read_off(finding):
        return "<p>Seen in the readings themselves; nothing was fitted.</p>"
    if not rivals:
        return "<p>No other effect of the catalogue comes near.</p>"
    rows = [[EFFECTS[one.name].title, f"{rounded(one.separation, 2)} noises"] for one in rivals]
    told = dict.fromkeys(one.separate_by for one in rivals if one.separate_by)
    experiments = "".join(f"<p><b>To tell them apart:</b> {_escaped(one)}</p>" for one in told)
    return table(["rival: might be instead", "stays behind by"], rows) + experiments


def _escaped(text: str) -> str:
    return html.escape(text)
