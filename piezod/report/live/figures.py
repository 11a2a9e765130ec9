"""Figures of the live page."""

from collections.abc import Callable

import numpy as np
from bokeh.events import Event, RangesUpdate, Reset
from bokeh.models import (
    ColumnDataSource,
    DatetimeTicker,
    DatetimeTickFormatter,
    HoverTool,
    Range1d,
)
from bokeh.models.annotations import Span, Title
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.report.figures.durations import BAR_START, EDGES_us, bars, histogram
from piezod.report.figures.layout import AXIS_WIDTH, apply_layout, labelled_figure
from piezod.report.live.curves import LOOP, OVER_TIME
from piezod.report.live.feed import WINDOW_s
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

NO_COUNTS = np.zeros(EDGES_us.size - 1, dtype=np.int64)
NEARLY = 0.98  # of the window: a range at least as long is not zoomed
_CLOCK = "%H:%M:%S"
RESENT_ms = 1e-3
TOOLS = "xbox_zoom,xwheel_zoom,reset"


class Figures:
    """Figures of one viewer, with their data sources and axis ranges.

    Parameters
    ----------
    bench
        Configuration with the limits that the figures show.
    """

    def __init__(self, bench: BenchConfig) -> None:
        self.over_time = ColumnDataSource({name: [] for name in OVER_TIME})
        self.loop = ColumnDataSource({name: [] for name in LOOP})
        self.now = ColumnDataSource({name: [] for name in LOOP})
        self.durations = {name: ColumnDataSource(bars(NO_COUNTS)) for name in ("lateness", "exchange")}
        self.summaries = {name: Title(text="", text_font_style="normal") for name in self.durations}
        limits = bench.limits
        self.force_range, self.loop_range = (_with_margin(limits.force_min_N, limits.force_trip_N) for _ in range(2))
        self.error_range = Range1d(start=-1.0, end=1.0)
        self.window = Range1d(start=0.0, end=1000.0 * WINDOW_s)
        self.force_title = Title(text="", text_font_style="normal")
        self.force = self._force()
        self.force.add_layout(self.force_title, "above")
        self.error = self._error()
        self.voltage = self._voltage(bench)
        self.curve = self._loop(bench)
        self.lateness = _histogram("How late the ticks were", self.durations["lateness"], bench, BLUE)
        self.lateness.add_layout(self.summaries["lateness"], "above")
        self.exchange = _histogram("How long an exchange took", self.durations["exchange"], bench, GREEN)
        self.exchange.add_layout(self.summaries["exchange"], "above")

    def on_zoom(self, call: Callable[..., None]) -> None:
        """Call a function with `zoomed` when a viewer zooms the curves over time, and when he resets them."""
        sent_ms = 0.0

        def zoom(event: Event) -> None:
            nonlocal sent_ms
            assert isinstance(event, RangesUpdate)
            first_ms, last_ms = float(event.x0 or 0.0), float(event.x1 or 0.0)
            zoomed = last_ms - first_ms < NEARLY * 1000.0 * WINDOW_s
            if zoomed and abs(first_ms - sent_ms) > 10.0 * RESENT_ms:
                sent_ms = first_ms + RESENT_ms  # a pending update may have undone it; equal values are not sent
                self.window.update(start=sent_ms, end=last_ms + RESENT_ms)
            call(zoomed=zoomed)

        for plot in (self.force, self.error, self.voltage):
            plot.on_event(RangesUpdate, zoom)
            plot.on_event(Reset, lambda _: call(zoomed=False))

    def roots(self) -> dict[str, figure]:
        """Figures by their name in the page template."""
        names = ("force", "error", "voltage", "curve", "lateness", "exchange")
        return {name: getattr(self, name) for name in names}

    def _force(self) -> figure:
        plot = self._timed("Force and reference", "force [N]", 260, self.force_range)
        plot.line("time_ms", "reference_N", source=self.over_time, color=GREY, line_width=3, legend_label="reference")
        plot.line("time_ms", "force_N", source=self.over_time, color=BLUE, legend_label="force")
        return _finish(plot, "{0.00} N", {"reference": "@reference_N", "force": "@force_N"})

    def _error(self) -> figure:
        plot = self._timed("Error: force minus reference", "error [N]", 190, self.error_range)
        plot.line("time_ms", "error_N", source=self.over_time, color=ORANGE)
        plot.add_layout(Span(location=0.0, dimension="width", line_color=GREY, line_width=1))
        return _finish(plot, "{0.000} N", {"error": "@error_N"})

    def _voltage(self, bench: BenchConfig) -> figure:
        limits = bench.limits
        voltage_range = _with_margin(limits.voltage_min_V, limits.voltage_max_V)
        plot = self._timed("Voltage and its limits", "voltage [V]", 220, voltage_range)
        for limit_V in (limits.voltage_min_V, limits.voltage_max_V):
            plot.add_layout(Span(location=limit_V, dimension="width", line_color=RED, line_dash="dashed"))
        plot.line("time_ms", "voltage_V", source=self.over_time, color=BLUE)
        return _finish(plot, "{0.00} V", {"voltage": "@voltage_V"})

    def _loop(self, bench: BenchConfig) -> figure:
        limits = bench.limits
        plot = labelled_figure(
            "Force over voltage",
            "voltage [V]",
            "force [N]",
            330,
            x_range=_with_margin(limits.voltage_min_V, limits.voltage_max_V),
            y_range=self.loop_range,
            tools="",
        )
        plot.line("voltage_V", "force_N", source=self.loop, color=BLUE, line_alpha=0.75)
        plot.scatter("voltage_V", "force_N", source=self.now, color=RED, size=10)
        return _finish(plot, "{0.00}", {"voltage [V]": "@voltage_V", "force [N]": "@force_N"})

    def _timed(self, title: str, label: str, height: int, y_range: Range1d) -> figure:
        plot = figure(title=title, y_axis_label=label, height=height, x_range=self.window, y_range=y_range, tools=TOOLS)
        plot.xaxis.formatter = DatetimeTickFormatter(
            milliseconds=_CLOCK, seconds=_CLOCK, minsec=_CLOCK, minutes=_CLOCK, hourmin=_CLOCK, hours=_CLOCK
        )
        plot.xaxis.ticker = DatetimeTicker(desired_num_ticks=4)
        plot.min_border_left = AXIS_WIDTH
        return plot


def _with_margin(low: float, high: float) -> Range1d:
    margin = 0.05 * (high - low)
    return Range1d(start=low - margin, end=high + margin)


def fit_range(axis_range: Range1d, *curves: NDArray[np.float64]) -> None:
    """Set an axis range in place so that it contains all finite values with a margin; no change without values.

    Parameters
    ----------
    axis_range
        Range of the axis; it changes.
    *curves
        Values of each curve, shape (N,) [unit of the axis], at least one curve.
    """
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    if values.size:
        low, high = float(values.min()), float(values.max())
        margin = max(0.08 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-6)
        axis_range.update(start=low - margin, end=high + margin)


def _histogram(title: str, source: ColumnDataSource, bench: BenchConfig, colour: str) -> figure:
    plot = histogram(
        title,
        source,
        bench.dt_s,
        colour,
        height=240,
        x_range=Range1d(start=1.0, end=max(2e5, 2e6 * bench.dt_s)),
        y_range=Range1d(start=BAR_START, end=2.0 * WINDOW_s * bench.rate_Hz),
        tools="",
    )
    return _finish(plot, "", {"from, to [\N{MICRO SIGN}s]": "@left{0.0}, @right{0.0}", "ticks": "@count{0}"})


def _finish(plot: figure, number_format: str, fields: dict[str, str]) -> figure:
    """Add layout and tooltip to a figure. The number format applies to fields without a format of their own."""
    apply_layout(plot, click_policy="none", spacing=6, glyph_height=14, label_height=14)
    tips = [(name, field if "{" in field else f"{field}{number_format}") for name, field in fields.items()]
    plot.add_tools(HoverTool(tooltips=tips))
    return plot
