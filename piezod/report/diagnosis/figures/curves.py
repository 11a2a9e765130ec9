"""Figures of held-out errors, of curves over time, and of loops."""

from collections.abc import Sequence

import numpy as np
from bokeh.models import ColumnDataSource, Range1d
from bokeh.models.annotations import Span
from bokeh.models.glyphs import Text
from bokeh.plotting import figure

from piezod.diagnose.findings import Findings, Place
from piezod.diagnose.verdict.words import rounded, unit_words
from piezod.report.diagnosis.figures.drawing import (
    EXTENDED,
    GIVEN,
    MEASURED,
    Columns,
    column_source,
    draw_curve,
    finish,
    mark_rejected,
    new_figure,
    places_on,
    shade,
)
from piezod.report.diagnosis.residual.residuals import Residuals
from piezod.report.diagnosis.wording import observed_directly
from piezod.report.figures.thinning import envelope, envelope_times, extremes, robust_range
from piezod.report.style import GREEN, GREY

FLEXIBLE = "#CC79A7"  # reddish purple of this palette
TEXT = "#333333"
WITHOUT = {"new": "without {}", "changed": "{} as before", "gone": "with {}"}
"""Name of the bar of an effect, by its status."""


def error_bars(findings: Findings, extended: str) -> figure:
    """Error of the given model, without each effect and with all, and the noise floor.

    Parameters
    ----------
    extended
        Name of the model after the diagnosis.
    """
    bars = held_out_errors(findings, extended)
    highest = max(error for _, error, _ in bars)
    columns = {
        "row": [-float(k) for k in range(len(bars))],
        "start": [0.0] * len(bars),
        "error": [error for _, error, _ in bars],
        "colour": [colour for _, _, colour in bars],
        "name": [name for name, _, _ in bars],
        "label": [rounded(error) for _, error, _ in bars],
    }
    source = ColumnDataSource(columns)
    plot = figure(
        title=f"Error [{unit_words(findings.unit)}]",
        x_range=Range1d(start=0.0, end=1.15 * highest),
        y_range=Range1d(start=0.4 - len(bars), end=0.75),
        height=75 + 44 * len(bars),
        tools="save",
    )
    floor = Span(location=findings.floor, dimension="height", line_color=GREEN, line_dash="dashed", level="underlay")
    plot.add_layout(floor)
    plot.hbar(y="row", right="error", height=0.42, color="colour", source=source)
    plot.text("error", "row", "label", source=source, x_offset=6, text_baseline="middle", text_font_size="13px")
    names = Text(x="start", y="row", text="name", x_offset=2, y_offset=-13, text_font_size="13px", text_color=TEXT)
    names.background_fill_color = "#ffffff"
    plot.add_glyph(source, names)
    plot.yaxis.visible = False
    plot.ygrid.grid_line_color = None
    return finish(plot)


def held_out_errors(findings: Findings, extended: str) -> list[tuple[str, float, str]]:
    """Name, error [output unit] and colour of each bar.

    Parameters
    ----------
    extended
        Name of the bar of the extended model.
    """
    fitted = [finding for finding in findings.effects if not observed_directly(finding)]
    bars = [
        ("given model", findings.before, GIVEN),
        *((WITHOUT[finding.status].format(finding.title), finding.before, GREY) for finding in fitted),
        (extended, findings.least, EXTENDED),
    ]
    if findings.verdict in ("partly_explained", "unexplained"):
        flexible = findings.least * float(np.sqrt(max(1.0 - findings.explainable, 0.0)))
        bars.append(("a flexible model without physics", flexible, FLEXIBLE))
    return [*bars, ("noise floor", findings.floor, GREEN)]


def time_figures(
    recording: Residuals, points: int, places: Sequence[Place], units: tuple[str, str], extended: str
) -> tuple[list[figure], Columns]:
    """Measured and modelled output over time, and the residuals, with a common time axis.

    Parameters
    ----------
    places
        Places in which the given model is wrong.
    extended
        Name of the model after the diagnosis.
    """
    unit = units[1]
    accepted = np.where(recording.series.counts, 1.0, np.nan)
    columns = {
        "time_s": envelope_times(recording.time_s, points),
        "measured": envelope(recording.measured, points),
        "given": envelope(recording.given, points),
        "extended": envelope(recording.extended, points),
        "before": envelope(recording.before * accepted, points),
        "after": envelope(recording.after * accepted, points),
    }
    source = column_source(columns, exact=("time_s",))
    output = new_figure("Over time", "time [s]", f"output [{unit}]", 300, zoom_x=True)
    draw_curve(output, source, "measured", "measured", MEASURED, width=3, alpha=0.55)
    draw_curve(output, source, "given", "given model", GIVEN)
    draw_curve(output, source, "extended", extended, EXTENDED)
    residual = new_figure("Residual: measured minus model", "time [s]", f"residual [{unit}]", 240, zoom_x=True)
    residual.y_range = robust_range(
        *(values[recording.series.counts] for values in (recording.before, recording.after))
    )
    residual.x_range = output.x_range
    draw_curve(residual, source, "before", "given model", GIVEN)
    draw_curve(residual, source, "after", extended, EXTENDED)
    for plot in (output, residual):
        shade(plot, places_on(places, "time_s"))
        mark_rejected(plot, recording)
    return [finish(output), finish(residual)], columns


def loop_figures(
    recording: Residuals, points: int, units: tuple[str, str], extended: str
) -> tuple[list[figure], Columns]:
    """Measured and modelled output over the command, and the residuals over the command.

    Parameters
    ----------
    extended
        Name of the model after the diagnosis.
    """
    index = extremes(recording.measured - recording.given, points)
    accepted = np.where(recording.series.counts, 1.0, np.nan)[index]
    columns = {
        "command": recording.series.command_V[index],
        "measured": recording.measured[index],
        "given": recording.given[index],
        "extended": recording.extended[index],
        "before": recording.before[index] * accepted,
        "after": recording.after[index] * accepted,
    }
    source = column_source(columns)
    loop = new_figure("Hysteresis loop", f"command [{units[0]}]", f"output [{units[1]}]", 340)
    residual = new_figure("Residual over the command", f"command [{units[0]}]", f"residual [{units[1]}]", 340)
    residual.y_range = robust_range(
        *(values[recording.series.counts] for values in (recording.before, recording.after))
    )
    draw_curve(loop, source, "measured", "measured", MEASURED, x="command", width=3, alpha=0.55)
    draw_curve(loop, source, "given", "given model", GIVEN, x="command")
    draw_curve(loop, source, "extended", extended, EXTENDED, x="command")
    draw_curve(residual, source, "before", "given model", GIVEN, x="command", alpha=0.8)
    draw_curve(residual, source, "after", extended, EXTENDED, x="command", alpha=0.8)
    return [finish(loop), finish(residual)], columns
