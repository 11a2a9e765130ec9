"""Histograms of durations: the lateness of ticks and the duration of exchanges."""

from collections import deque
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, LogTicker
from bokeh.models.annotations import Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.report.style import RED

CLASSES_A_DECADE = 8
LONGEST_us = 9999.5  # longer durations are written in milliseconds
EDGES_us = np.logspace(0, 6, 6 * CLASSES_A_DECADE + 1)
"""Edges of the histogram classes [us]. The first and the last class also count shorter and longer durations."""

BAR_START = 0.5  # lower end of the bars on the logarithmic axis, below one tick


class RecentDurations:
    """Durations of the newest ticks.

    Parameters
    ----------
    capacity
        Number of durations to hold at least, if as many were added.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._chunks: deque[NDArray[np.int64]] = deque()
        self._size = 0

    def add(self, values_ns: NDArray[np.int64]) -> None:
        """Append durations [ns], and drop the oldest chunks that exceed the capacity."""
        self._chunks.append(values_ns[-self._capacity :].copy())
        self._size += self._chunks[-1].size
        while self._size - self._chunks[0].size >= self._capacity:
            self._size -= self._chunks.popleft().size

    def clear(self) -> None:
        """Drop all durations."""
        self._chunks.clear()
        self._size = 0

    def counts(self) -> NDArray[np.int64]:
        """Number of durations in each class, shape (len(EDGES_us) - 1,)."""
        classes = np.searchsorted(EDGES_us, self._values_us(), side="right") - 1
        result: NDArray[np.int64] = np.bincount(
            np.clip(classes, 0, EDGES_us.size - 2), minlength=EDGES_us.size - 1
        ).astype(np.int64)
        return result

    def summary(self) -> str:
        """Format median, 99th percentile and maximum."""
        values_us = self._values_us()
        if not values_us.size:
            return "no tick yet"
        p50, p99 = np.percentile(values_us, (50, 99))
        return f"p50 {_with_unit(p50)}, p99 {_with_unit(p99)}, max {_with_unit(values_us.max())}"

    def _values_us(self) -> NDArray[np.float64]:
        if not self._chunks:
            return np.empty(0)
        values: NDArray[np.float64] = np.concatenate(list(self._chunks)) * 1e-3
        return values


def bars(counts: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Columns that draw a histogram: the edges of the bars, their heights `top`, and the counts.

    Parameters
    ----------
    counts
        Number of durations in each class of `EDGES_us`, shape (classes,).
    """
    return {"left": EDGES_us[:-1], "right": EDGES_us[1:], "top": np.maximum(counts, BAR_START), "count": counts}


def histogram(title: str, source: ColumnDataSource, period_s: float | None, colour: str, **options: Any) -> figure:  # noqa: ANN401
    """Histogram of durations with logarithmic axes, and a line at the tick period.

    Parameters
    ----------
    source
        Columns of `bars`.
    period_s
        Tick period [s]; None if unknown.
    options
        Bokeh properties of the figure, such as height and ranges.
    """
    plot = figure(
        title=title,
        x_axis_label="time [\N{MICRO SIGN}s]",
        y_axis_label="ticks",
        x_axis_type="log",
        y_axis_type="log",
        **options,
    )
    look: dict[str, Any] = {"source": source, "color": colour, "line_color": "#fff", "name": "ticks"}
    plot.quad(left="left", right="right", bottom=BAR_START, top="top", **look)
    if period_s is not None:
        plot.add_layout(Span(location=1e6 * period_s, dimension="height", line_color=RED, line_dash="dashed"))
    plot.xaxis.ticker = LogTicker(desired_num_ticks=6)
    return plot


def _with_unit(value_us: float) -> str:
    return f"{value_us:.0f} \N{MICRO SIGN}s" if value_us < LONGEST_us else f"{1e-3 * value_us:.1f} ms"
