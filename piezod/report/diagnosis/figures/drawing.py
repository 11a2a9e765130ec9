"""Axes, curves, bands and shaded places that the figures of a diagnosis share."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from bokeh.models import ColumnDataSource, CustomJSTickFormatter, HoverTool
from bokeh.models.annotations import Band, BoxAnnotation, Span
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.diagnose.findings import Place
from piezod.report.diagnosis.residual.residuals import Residuals
from piezod.report.figures.layout import apply_layout
from piezod.report.style import BLUE, ORANGE, RED

Columns = dict[str, Array]
Axis = Literal["linear", "log"]

MEASURED, GIVEN, EXTENDED = "#555555", ORANGE, BLUE
MOST_PLACES = 40  # shaded places of one figure
DECIMAL_TICKS = "return String(Number(tick.toPrecision(3)))"  # JavaScript: 0.1 instead of a power of ten


def new_figure(title: str, x: str, y: str, height: int, *, zoom_x: bool = False, x_axis: Axis = "linear") -> figure:
    """Create a figure with tools and tooltip.

    Parameters
    ----------
    title
        Title; empty for none.
    x, y
        Labels of the axes.
    height
        Height [pixels].
    zoom_x
        Whether pan and zoom act on the x axis only, as for curves over time.
    """
    prefix = "x" if zoom_x else ""
    plot = figure(
        title=title or None,
        x_axis_label=x,
        y_axis_label=y,
        height=height,
        x_axis_type=x_axis,
        tools=f"{prefix}pan,{prefix}wheel_zoom,{prefix}box_zoom,reset,save",
        active_drag=f"{prefix}box_zoom",
        active_scroll=None,
    )
    plot.add_tools(HoverTool(tooltips=[(x, "$x{0.0000}"), (y, "$y{0.0000}")]))
    if x_axis == "log":
        plot.xaxis.formatter = CustomJSTickFormatter(code=DECIMAL_TICKS)
    return plot


def finish(plot: figure) -> figure:
    """Apply the shared layout to a figure with all its curves, and return it.

    Parameters
    ----------
    plot
        Figure; it changes.
    """
    plot.min_border_right = 12
    return apply_layout(plot)


def column_source(columns: Mapping[str, Array], exact: Sequence[str] = ()) -> ColumnDataSource:
    """Columns in single precision, except those named in `exact`.

    Parameters
    ----------
    columns
        Columns by name, all of shape (N,).
    exact
        Names of the columns that stay in double precision.
    """
    return ColumnDataSource({k: v if k in exact else v.astype(np.float32) for k, v in columns.items()})


def draw_curve(
    plot: figure,
    source: ColumnDataSource,
    y: str,
    label: str,
    colour: str,
    *,
    x: str = "time_s",
    width: float = 1.0,
    alpha: float = 1.0,
    dash: str = "solid",
) -> None:
    """Draw column `y` over column `x`, with an entry in the legend.

    Parameters
    ----------
    y
        Name of the column of the ordinate.
    colour
        Colour as in CSS.
    x
        Name of the column of the abscissa.
    width
        Width of the line [pixels].
    alpha
        Opacity, 0 to 1.
    dash
        Dash pattern of Bokeh: "solid", "dashed" and the like.
    """
    plot.line(x, y, source=source, color=colour, line_width=width, line_alpha=alpha, line_dash=dash, legend_label=label)


def draw_band(plot: figure, source: ColumnDataSource, x: str, name: str, colour: str) -> None:
    """Fill the area between the columns `NAME_low` and `NAME_high`.

    Parameters
    ----------
    x
        Name of the column of the abscissa.
    name
        Name of both limits, without `_low` and `_high`.
    colour
        Colour as in CSS.
    """
    lower, upper = f"{name}_low", f"{name}_high"
    plot.add_layout(Band(base=x, lower=lower, upper=upper, source=source, fill_color=colour, fill_alpha=0.15))


def places_on(places: Sequence[Place], axis: str) -> list[Place]:
    """Places on an axis of `Place`, at most `MOST_PLACES`; none for an empty axis.

    Parameters
    ----------
    axis
        Axis: `time_s`, `voltage_V` and the like.
    """
    return [place for place in places if axis and place.axis == axis][:MOST_PLACES]


def clipped(places: Sequence[Place], x: Array) -> list[Place]:
    """Places clipped to the range of the curves, so that a wide place does not compress them.

    Parameters
    ----------
    places
        Places on the axis of the curves.
    x
        Abscissa of the curves, shape (N,), N at least 1 [unit of the axis].
    """
    low, high = float(x.min()), float(x.max())
    visible = [place for place in places if place.low <= high and place.high >= low]
    return [replace(place, low=max(place.low, low), high=min(place.high, high)) for place in visible]


def shade(plot: figure, places: Sequence[Place]) -> None:
    """Hatch places in which the given model is significantly wrong; a place without width is a line.

    Parameters
    ----------
    places
        Places on the abscissa of the figure.
    """
    for place in places:
        if place.low == place.high:
            plot.add_layout(Span(location=place.low, dimension="height", line_color=RED, line_alpha=0.6))
        else:
            box = BoxAnnotation(
                left=place.low,
                right=place.high,
                fill_color=RED,
                fill_alpha=0.05,
                line_color=None,
                hatch_pattern="right_diagonal_line",
                hatch_color=RED,
                hatch_alpha=0.25,
                hatch_scale=14,
            )
            box.level = "underlay"
            plot.add_layout(box)


def mark_rejected(plot: figure, recording: Residuals) -> None:
    """Mark spans of time whose readings were rejected.

    Parameters
    ----------
    plot
        Figure over time to draw in.
    recording
        Recording with the mask of its readings.
    """
    accepted = np.concatenate(([True], recording.series.counts, [True])).astype(np.int8)
    edges = np.flatnonzero(np.diff(accepted))
    time_s = recording.time_s
    for first, end in list(zip(edges[::2], edges[1::2], strict=True))[:MOST_PLACES]:
        begin_s, end_s = time_s[max(first - 1, 0)], time_s[min(end, time_s.size - 1)]
        plot.add_layout(BoxAnnotation(left=begin_s, right=end_s, fill_color=MEASURED, fill_alpha=0.3, line_color=None))
