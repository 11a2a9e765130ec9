"""History of a bench's models as text, CSV table and page with a panel for each parameter; comparison of two models."""

import html
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from bokeh.models import ColumnDataSource, DatetimeTicker, DatetimeTickFormatter, HoverTool, Range1d
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.diagnose.findings import Value
from piezod.diagnose.verdict.words import PER_CENT, unit_words
from piezod.history.changes import ParameterChange
from piezod.history.comparison import ModelComparison
from piezod.history.parameters import Key
from piezod.history.timeline import Step, Timeline
from piezod.history.trends import Estimate, Trend
from piezod.history.words import interval_text, verdict_of, wording_of
from piezod.report.diagnosis.csv_tables import csv_text
from piezod.report.figures.layout import MOST_TICKS, apply_layout
from piezod.report.next_step import NextStep
from piezod.report.page import Part, table_html, write_page
from piezod.report.style import BLUE, GREY, ORANGE
from piezod.report.text_table import text_table
from piezod.runtime.files import written

MARK = "*"
NONE = "-"
PANEL_HEIGHT = 210  # [px]
MARGIN = 0.15  # beyond the drawn values, relative to their range
LEAST_SPAN = 0.02  # half of the least range of a panel, relative to the largest value


def history_text(timeline: Timeline, trends: Sequence[Trend] = ()) -> str:
    """Table of the models, the verdict with slow changes, and notes."""
    lines = text_table(history_rows(timeline), left_aligned=2)
    notes = [f"note: {step.entry.paths[0]}: {note}" for step in timeline.steps for note in step.notes]
    return "\n".join([*lines, verdict_of(timeline, trends), *notes])


def history_rows(timeline: Timeline) -> list[list[str]]:
    """Table with a row for each model; a parameter that has changed since the reference is marked."""
    unit = unit_words(timeline.steps[0].entry.model.output.unit)
    header = ["date (UTC)", "model", f"held-out error [{unit}]", f"noise [{unit}]"]
    return [[*header, *(key.heading(timeline.unit_of(key)) for key in timeline.keys)]] + [
        [
            f"{step.entry.date:%Y-%m-%d %H:%M}",
            _name(step),
            _number(step.entry.model.provenance.fit.rms_held_out),
            _number(_noise_of(step)),
            *(_cell(step, key) for key in timeline.keys),
        ]
        for step in timeline.steps
    ]


def write_history_csv(path: Path, timeline: Timeline) -> None:
    """Write a table with a row for each model, and value, interval and mark of each parameter.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    ends = ("", "_low", "_high", "_changed")
    names = [f"{key}{end}" for key in timeline.keys for end in ends]
    rows = list[list[object]]()
    for step in timeline.steps:
        entry, cells = step.entry, list[object]()
        for key in timeline.keys:
            value = step.parameters.get(key)
            cells += [""] * 4 if value is None else [*_digits(value), int(step.is_marked(key))]
        known = entry.model.provenance.fit.rms_held_out, _noise_of(step)
        errors = ["" if error is None else str(error) for error in known]
        head = [entry.date.isoformat(), entry.paths[0], min(entry.hashes), entry.parent or ""]
        rows.append([*head, *errors, *cells])
    header = ["date", "file", "sha256", "parent", "held_out_error", "noise", *names]
    written(path, csv_text(header, rows), parents=True)


def write_history_page(
    path: Path,
    timeline: Timeline,
    words: str | None = None,
    recordings: str = "",
    trends: Sequence[Trend] = (),
    estimates: Mapping[Key, Sequence[Estimate]] | None = None,
    step: NextStep | None = None,
) -> None:
    """Write the page: verdict, a panel for each parameter, table, and notes.

    Parameters
    ----------
    words
        Verdict; None: the verdict of the models.
    recordings
        HTML on the recordings of the bench, behind the table of the models.
    trends, estimates
        Slow changes, and the estimates of each recording alone.
    step
        Next step; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    words, estimates = words or verdict_of(timeline, trends), estimates or {}
    rows = history_rows(timeline)
    dates = _date_range(timeline, estimates)
    lines = {trend.key: trend for trend in trends}
    panels = [_panel(timeline, key, dates, estimates.get(key, ()), lines.get(key)) for key in timeline.keys]
    notes = "".join(
        f"<li>{html.escape(f'{_name(step)}: {note}')}</li>" for step in timeline.steps for note in step.notes
    )
    legend = "Bars: 95 % intervals. Orange: changed since the parent, or since the model before."
    legend += " Small dots: by each recording alone." if estimates else ""
    legend += " Orange line: slow change." if trends else ""
    parts: list[Part] = [
        panels,
        f"<p class='dim'>{legend}</p>",
        table_html(rows[0], rows[1:]),
        recordings,
        f"<h2>Notes</h2><ul>{notes}</ul>" if notes else "",
    ]
    write_page(path, "History", ("History of the models", f"{words[0].upper()}{words[1:]}."), parts, step)


def _digits(value: Value) -> list[str]:
    """Value and ends of its interval with ten digits."""
    return [f"{number:.10g}" for number in (value.value, value.low, value.high)]


def _panel(timeline: Timeline, key: Key, dates: Range1d, estimates: Sequence[Estimate], trend: Trend | None) -> figure:
    """Value of a parameter over time, with interval bars; marked values are orange, estimates small dots."""
    steps = [step for step in timeline.steps if key in step.parameters]
    unit = timeline.unit_of(key)
    factor = PER_CENT if unit == "1" else 1.0
    ends = np.array([[step.parameters[key].low, step.parameters[key].high] for step in steps]) * factor
    source = ColumnDataSource(
        {
            "date": [_plain(step.entry.date) for step in steps],
            "value": [factor * step.parameters[key].value for step in steps],
            "low": ends[:, 0],
            "high": ends[:, 1],
            "colour": [ORANGE if step.is_marked(key) else BLUE for step in steps],
            "model": [_name(step) for step in steps],
        }
    )
    shown = "%" if unit == "1" else wording_of(steps[0].entry.model).unit(unit)
    alone = [factor * estimate.value.value for estimate in estimates]
    plot = figure(
        title=f"{key.heading(unit)} [{shown}]",
        x_axis_type="datetime",
        x_range=dates,
        y_range=value_range(np.append(ends, alone)),
        height=PANEL_HEIGHT,
    )
    if trend is not None:
        line = [factor * trend.before.value, factor * trend.after.value]
        plot.line([_plain(trend.first), _plain(trend.last)], line, color=ORANGE, line_width=2)
    plot.scatter([_plain(estimate.date) for estimate in estimates], alone, color=GREY, size=4)
    plot.line("date", "value", source=source, color=GREY)
    plot.segment("date", "low", "date", "high", source=source, color="colour", line_width=3, alpha=0.6)
    plot.scatter("date", "value", source=source, color="colour", size=8)
    plot.xaxis.formatter = DatetimeTickFormatter(days="%d %b", months="%b %Y", hours="%H:%M", minutes="%H:%M")
    plot.xaxis.ticker = DatetimeTicker(desired_num_ticks=MOST_TICKS)
    plot.add_tools(HoverTool(tooltips=[("model", "@model"), ("value", "@value"), ("interval", "@low to @high")]))
    return apply_layout(plot)


def _date_range(timeline: Timeline, estimates: Mapping[Key, Sequence[Estimate]]) -> Range1d:
    """Dates of all models and estimates with a margin, at least a minute."""
    dates = [_plain(step.entry.date) for step in timeline.steps]
    dates += [_plain(estimate.date) for some in estimates.values() for estimate in some]
    margin = max(MARGIN * (max(dates) - min(dates)), timedelta(seconds=30))
    return Range1d(start=min(dates) - margin, end=max(dates) + margin)


def value_range(ends: NDArray[np.float64]) -> Range1d:
    """Range of values, of any shape, with a margin; it spans at least 4 % of the largest value."""
    low, high = float(ends.min()), float(ends.max())
    half = max(0.5 * (high - low) * (1.0 + 2.0 * MARGIN), LEAST_SPAN * float(np.abs(ends).max()), 1e-12)
    middle = 0.5 * (low + high)
    return Range1d(start=middle - half, end=middle + half)


def _plain(date: datetime) -> datetime:
    """Date in UTC without zone, as Bokeh draws it."""
    return date.replace(tzinfo=None)


def _cell(step: Step, key: Key) -> str:
    value = step.parameters.get(key)
    if value is None:
        change = step.change_of(key)
        return f"{MARK} {NONE}" if change is not None else NONE
    text = interval_text(key, value, step.entry.model)
    return f"{MARK} {text}" if step.is_marked(key) else text


def _name(step: Step) -> str:
    """File of a model with its folder."""
    path = step.entry.paths[0]
    return "/".join(path.resolve().parts[-2:])


def _noise_of(step: Step) -> float | None:
    """Rms noise of the recordings of a model [output unit]; None: its file does not state it."""
    information = step.entry.model.information
    return None if information is None else information.noise


def _number(value: float | None) -> str:
    return NONE if value is None else f"{value:.3g}"


def model_comparison_text(comparison: ModelComparison) -> str:
    """Table of the parameters, the verdict, and notes."""
    return "\n".join(
        [
            *text_table(model_comparison_rows(comparison)),
            comparison.verdict,
            *(f"note: {note}" for note in comparison.notes),
        ]
    )


def model_comparison_rows(comparison: ModelComparison) -> list[list[str]]:
    """Table with a row for each parameter: values in both models, z, and whether it differs."""
    header = ["parameter", *(path.name for path in comparison.paths), "z", ""]
    return [header, *(_row(parameter, comparison) for parameter in comparison.parameters)]


def write_model_comparison_page(path: Path, comparison: ModelComparison) -> None:
    """Write the page: verdict, table, and notes.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    words, rows = comparison.verdict, model_comparison_rows(comparison)
    first, second = comparison.paths
    note = "z: difference over its standard error, from the 95 % intervals."
    notes = "".join(f"<li>{html.escape(text)}</li>" for text in (note, *comparison.notes))
    head = f"Comparison of {first.name} and {second.name}", f"{words[0].upper()}{words[1:]}."
    write_page(path, "Comparison", head, [table_html(rows[0], rows[1:]), f"<h2>Notes</h2><ul>{notes}</ul>"])


def _row(parameter: ParameterChange, comparison: ModelComparison) -> list[str]:
    values = zip((parameter.before, parameter.after), comparison.models, strict=True)
    cells = [NONE if value is None else interval_text(parameter.key, value, model) for value, model in values]
    z = NONE if parameter.z is None else f"{parameter.z:+.1f}"
    return [parameter.heading, *cells, z, "differs" if parameter.changed else "agrees"]
