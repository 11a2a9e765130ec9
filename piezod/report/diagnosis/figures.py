"""The figures of a diagnosis: measured against both models, what is left over every driver, and its map."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from bokeh.models import (
    BasicTicker,
    ColumnDataSource,
    CustomJSTickFormatter,
    FixedTicker,
    HoverTool,
    LinearColorMapper,
    Range1d,
)
from bokeh.models.annotations import Band, BoxAnnotation, ColorBar, Span
from bokeh.models.glyphs import Image, Text
from bokeh.palettes import interp_palette
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.diagnose.findings import Findings, Place
from piezod.diagnose.words import rounded, unit_words
from piezod.report.diagnosis.residual_views import Memory, Residuals, State, View
from piezod.report.diagnosis.spectra import Map
from piezod.report.diagnosis.wording import read_off
from piezod.report.figures.thinning import envelope, envelope_times, extremes, usual_range
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

Array = NDArray[np.float64]
Columns = dict[str, Array]
Axis = Literal["linear", "log"]

MEASURED, GIVEN, EXTENDED = "#555555", ORANGE, BLUE
SHADE = RED
FLEXIBLE = "#CC79A7"  # of the same palette
INK = "#333333"
HEAT = ("#ffffff", "#fdd9a0", "#e8801a", "#a33a00", "#2b0c00")  # ever darker, so it needs no colour to be read
FEWEST_DB, MOST_DB = 20.0, 60.0
SHADED = 40  # places that one figure shows
DECIMAL = "return String(Number(tick.toPrecision(3)))"  # 0.1 instead of a power of ten


def error_bars(findings: Findings, extended: str) -> figure:
    """Error on data left out: given model, without each effect, with all, and the noise floor."""
    rows = bars_of(findings, extended)
    highest = max(value for _, value, _ in rows)
    columns = {
        "row": [-float(k) for k in range(len(rows))],
        "start": [0.0] * len(rows),
        "error": [value for _, value, _ in rows],
        "colour": [colour for _, _, colour in rows],
        "name": [name for name, _, _ in rows],
        "said": [rounded(value) for _, value, _ in rows],
    }
    source = ColumnDataSource(columns)
    plot = figure(
        title=f"Error on data left out [{unit_words(findings.unit)}]",
        x_range=Range1d(start=0.0, end=1.15 * highest),
        y_range=Range1d(start=0.4 - len(rows), end=0.75),
        height=75 + 44 * len(rows),
        tools="save",
    )
    floor = Span(location=findings.floor, dimension="height", line_color=GREEN, line_dash="dashed", level="underlay")
    plot.add_layout(floor)
    plot.hbar(y="row", right="error", height=0.42, color="colour", source=source)
    plot.text("error", "row", "said", source=source, x_offset=6, text_baseline="middle", text_font_size="13px")
    names = Text(x="start", y="row", text="name", x_offset=2, y_offset=-13, text_font_size="13px", text_color=INK)
    names.background_fill_color = "#ffffff"
    plot.add_glyph(source, names)
    plot.yaxis.visible = False
    plot.ygrid.grid_line_color = None
    return _finish(plot)


def bars_of(findings: Findings, extended: str) -> list[tuple[str, float, str]]:
    """Name, error and colour of every bar."""
    fitted = [one for one in findings.effects if not read_off(one)]
    rows = [
        ("given model", findings.before, GIVEN),
        *((f"without {one.title}", one.before, GREY) for one in fitted),
        (extended, findings.left, EXTENDED),
    ]
    if findings.verdict in ("partly_explained", "unexplained"):
        reached = findings.left * float(np.sqrt(max(1.0 - findings.explainable, 0.0)))
        rows.append(("a flexible model without physics", reached, FLEXIBLE))
    return [*rows, ("noise floor", findings.floor, GREEN)]


def time_lines(
    one: Residuals, points: int, places: Sequence[Place], units: tuple[str, str], extended: str
) -> tuple[list[figure], Columns]:
    """Measured and both models over time, and below, on the same time axis, what is left."""
    unit = units[1]
    left = np.where(one.series.counts, 1.0, np.nan)
    columns = {
        "time_s": envelope_times(one.time_s, points),
        "measured": envelope(one.measured, points),
        "given": envelope(one.given, points),
        "extended": envelope(one.extended, points),
        "before": envelope(one.before * left, points),
        "after": envelope(one.after * left, points),
    }
    source = _source(columns, exact=("time_s",))
    over = _figure("Over time", "time [s]", f"output [{unit}]", 300, along_x=True)
    _line(over, source, "measured", "measured", MEASURED, width=3, alpha=0.55)
    _line(over, source, "given", "given model", GIVEN)
    _line(over, source, "extended", extended, EXTENDED)
    rest = _figure("Left over time: measured less model", "time [s]", f"residual [{unit}]", 240, along_x=True)
    rest.y_range = usual_range(*(values[one.series.counts] for values in (one.before, one.after)))
    rest.x_range = over.x_range
    _line(rest, source, "before", "given model", GIVEN)
    _line(rest, source, "after", extended, EXTENDED)
    for plot in (over, rest):
        _shade(plot, _on(places, "time_s"))
        _mark_unbelieved(plot, one)
    return [_finish(over), _finish(rest)], columns


def loops(one: Residuals, points: int, units: tuple[str, str], extended: str) -> tuple[list[figure], Columns]:
    """Output over command, measured and by both models, and what is left over the command."""
    at = extremes(one.measured - one.given, points)
    blind = np.where(one.series.counts, 1.0, np.nan)[at]
    columns = {
        "command": one.series.command_V[at],
        "measured": one.measured[at],
        "given": one.given[at],
        "extended": one.extended[at],
        "before": one.before[at] * blind,
        "after": one.after[at] * blind,
    }
    source = _source(columns)
    loop = _figure("Hysteresis loop", f"command [{units[0]}]", f"output [{units[1]}]", 340)
    rest = _figure("What is left of the loop", f"command [{units[0]}]", f"residual [{units[1]}]", 340)
    rest.y_range = usual_range(*(values[one.series.counts] for values in (one.before, one.after)))
    _line(loop, source, "measured", "measured", MEASURED, x="command", width=3, alpha=0.55)
    _line(loop, source, "given", "given model", GIVEN, x="command")
    _line(loop, source, "extended", extended, EXTENDED, x="command")
    _line(rest, source, "before", "given model", GIVEN, x="command", alpha=0.8)
    _line(rest, source, "after", extended, EXTENDED, x="command", alpha=0.8)
    return [_finish(loop), _finish(rest)], columns


def driver_figure(view: View, places: Sequence[Place], unit: str, extended: str) -> tuple[list[figure], Columns]:
    """Binned mean and standard deviation over one driver, before and after; significant places shaded."""
    columns = {view.name: view.at, "readings": view.count, **_columns_of("before", view.before)}
    columns |= _columns_of("after", view.after)
    source = _source({**columns, **_bounds("before", view.before), **_bounds("after", view.after)})
    kind: Axis = "log" if view.logarithmic else "linear"
    plot = _figure("", view.label, f"residual [{unit}]", 250, x_axis=kind)
    for name, label, colour in (("before", "given model", GIVEN), ("after", extended, EXTENDED)):
        _band(plot, source, view.name, name, colour)
        if view.directions:
            _line(plot, source, f"{name}_rising", label, colour, x=view.name, width=2)
            _line(plot, source, f"{name}_falling", label, colour, x=view.name, width=2, dash="dashed")
        else:
            _line(plot, source, f"{name}_mean", label, colour, x=view.name, width=2)
    shaded = _on(places, view.axis)
    if view.axis == "rate_V_per_s":
        shaded += [Place(one.axis, -one.high, -one.low) for one in shaded]
    _shade(plot, _within(shaded, view.at))
    return [_finish(plot)], columns


def memory_figure(memory: Memory, places: Sequence[Place], extended: str) -> tuple[list[figure], Columns]:
    """Correlation of what is left with the command's past, by its age."""
    columns = {"age_s": memory.at_s, "before": memory.before, "after": memory.after}
    source = _source(columns)
    plot = _figure("", "memory: age of the command's past [s]", "correlation", 250, x_axis="log")
    _line(plot, source, "before", "given model", GIVEN, x="age_s", width=2)
    _line(plot, source, "after", extended, EXTENDED, x="age_s", width=2)
    _shade(plot, _on(places, "history_s"))
    return [_finish(plot)], columns


def spectrum_figure(
    spectra: tuple[Array, Array, Array], floor: float, places: Sequence[Place], unit: str, extended: str
) -> tuple[list[figure], Columns]:
    """Amplitude density before and after beside the floor; `floor` is that of white noise as large."""
    frequency_Hz, before, after = spectra
    columns = {"frequency_Hz": frequency_Hz, "before": before, "after": after}
    source = _source(columns)
    plot = figure(
        title="Spectrum of what is left",
        x_axis_label="frequency [Hz]",
        y_axis_label=f"{unit} / √Hz",
        height=280,
        x_axis_type="log",
        y_axis_type="log",
        tools="pan,wheel_zoom,box_zoom,reset,save",
        active_drag="box_zoom",
    )
    plot.xaxis.formatter = CustomJSTickFormatter(code=DECIMAL)
    plot.yaxis.formatter = CustomJSTickFormatter(code=DECIMAL)
    _line(plot, source, "before", "given model", GIVEN, x="frequency_Hz")
    _line(plot, source, "after", extended, EXTENDED, x="frequency_Hz")
    plot.line(
        [frequency_Hz[0], frequency_Hz[-1]], [floor, floor], color=GREEN, line_dash="dashed", legend_label="floor"
    )
    _shade(plot, _on(places, "frequency_Hz"))
    return [_finish(plot)], columns


def colour_scale(maps: Iterable[Map]) -> LinearColorMapper:
    """One scale for all maps: from the floor to the loudest."""
    loudest = max(float(np.quantile(one.level_dB, 0.999)) for one in maps)
    high = float(np.clip(10.0 * np.ceil(loudest / 10.0), FEWEST_DB, MOST_DB))
    return LinearColorMapper(palette=interp_palette(HEAT, 128), low=0.0, high=high)


def map_figure(one: Map, start_s: float, title: str, scale: LinearColorMapper) -> figure:
    """Power over time and frequency in decibels over the floor."""
    low, high = np.log10(one.frequency_Hz[0]), np.log10(one.frequency_Hz[-1])
    ends_s = start_s + one.time_s[[0, -1]]
    plot = figure(
        title=title,
        x_axis_label="time [s]",
        y_axis_label="frequency [Hz]",
        height=280,
        x_range=Range1d(start=ends_s[0], end=ends_s[1]),
        y_range=Range1d(start=low, end=high),
        tools="box_zoom,reset,save",
    )
    level = np.clip(np.round(one.level_dB), -30, 120).astype(np.int8)
    image = Image(image="level", x=ends_s[0], y=low, dw=ends_s[1] - ends_s[0], dh=high - low, color_mapper=scale)
    plot.add_glyph(ColumnDataSource({"level": [level]}), image)
    ticks = [decade + step for decade in range(-5, 6) for step in np.log10((1.0, 3.0))]
    plot.yaxis.ticker = FixedTicker(ticks=[float(tick) for tick in ticks if low <= tick <= high])
    plot.yaxis.formatter = CustomJSTickFormatter(code="return String(Number(Math.pow(10, tick).toPrecision(1)))")
    plot.add_layout(ColorBar(color_mapper=scale, title="dB", width=12, ticker=BasicTicker()), "right")
    return _finish(plot)


# --------------------------------------------------------------------------------------------------------- parts


def _figure(title: str, x: str, y: str, height: int, *, along_x: bool = False, x_axis: Axis = "linear") -> figure:
    """Figure with the tools that all share; along x only where time runs."""
    prefix = "x" if along_x else ""
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
        plot.xaxis.formatter = CustomJSTickFormatter(code=DECIMAL)
    return plot


def _finish(plot: figure) -> figure:
    """Width, toolbar and legend that all figures share."""
    plot.sizing_mode = "stretch_width"
    plot.toolbar.autohide = True
    plot.toolbar.logo = None
    plot.min_border_right = 12
    if plot.legend:
        plot.legend.orientation = "horizontal"
        plot.legend.border_line_color = None
        plot.legend.click_policy = "hide"
        plot.legend.label_text_font_size = "11px"
        plot.legend[0].update(margin=0, padding=2)
        plot.add_layout(plot.legend[0], "above")
    return plot


def _source(columns: Columns, exact: Sequence[str] = ()) -> ColumnDataSource:
    """Columns for the page, in single precision where that is enough."""
    return ColumnDataSource({k: v if k in exact else v.astype(np.float32) for k, v in columns.items()})


def _line(
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
    plot.line(x, y, source=source, color=colour, line_width=width, line_alpha=alpha, line_dash=dash, legend_label=label)


def _band(plot: figure, source: ColumnDataSource, x: str, name: str, colour: str) -> None:
    lower, upper = f"{name}_low", f"{name}_high"
    plot.add_layout(Band(base=x, lower=lower, upper=upper, source=source, fill_color=colour, fill_alpha=0.15))


def _columns_of(name: str, state: State) -> Columns:
    return {
        f"{name}_mean": state.mean,
        f"{name}_standard_deviation": state.spread,
        f"{name}_rising": state.rising,
        f"{name}_falling": state.falling,
    }


def _bounds(name: str, state: State) -> Columns:
    return {f"{name}_low": state.mean - state.spread, f"{name}_high": state.mean + state.spread}


def _on(places: Sequence[Place], axis: str) -> list[Place]:
    return [one for one in places if axis and one.axis == axis][:SHADED]


def _within(places: Sequence[Place], at: Array) -> list[Place]:
    """Places as far as a figure's curves go: wider ones would squeeze them."""
    low, high = float(at.min()), float(at.max())
    kept = [one for one in places if one.low <= high and one.high >= low]
    return [replace(one, low=max(one.low, low), high=min(one.high, high)) for one in kept]


def _shade(plot: figure, places: Sequence[Place]) -> None:
    """Where the given model is significantly wrong."""
    for one in places:
        if one.low == one.high:
            plot.add_layout(Span(location=one.low, dimension="height", line_color=SHADE, line_alpha=0.6))
        else:
            box = BoxAnnotation(
                left=one.low,
                right=one.high,
                fill_color=SHADE,
                fill_alpha=0.05,
                line_color=None,
                hatch_pattern="right_diagonal_line",
                hatch_color=SHADE,
                hatch_alpha=0.25,
                hatch_scale=14,
            )
            box.level = "underlay"
            plot.add_layout(box)


def _mark_unbelieved(plot: figure, one: Residuals) -> None:
    """Stretches whose readings are not believed."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], one.series.counts, [True])).astype(np.int8)))
    time_s = one.time_s
    for first, end in list(zip(edges[::2], edges[1::2], strict=True))[:SHADED]:
        left, right = time_s[max(first - 1, 0)], time_s[min(end, time_s.size - 1)]
        plot.add_layout(BoxAnnotation(left=left, right=right, fill_color=MEASURED, fill_alpha=0.3, line_color=None))
