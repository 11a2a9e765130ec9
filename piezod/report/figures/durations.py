"""How late ticks were, and how long their exchanges took: counted in classes, and drawn."""

from collections import deque
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource, LogTicker
from bokeh.models.annotations import Span
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.report.style import RED

CLASSES_A_DECADE = 8
LONGEST_us = 9999.5  # that is said in microseconds
EDGES_us = np.logspace(0, 6, 6 * CLASSES_A_DECADE + 1)
"""Edges of the classes [us]; what is shorter or longer is counted in the first or the last one."""

LEAST = 0.5  # where the bars of a logarithmic axis begin


class RecentDurations:
    """Durations of the newest ticks.

    Parameters
    ----------
    most
        How many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._pieces: deque[NDArray[np.int64]] = deque()
        self._size = 0

    def add(self, values_ns: NDArray[np.int64]) -> None:
        """Take in more [ns]; the oldest go, piece by piece."""
        self._pieces.append(values_ns[-self._most :].copy())
        self._size += self._pieces[-1].size
        while self._size - self._pieces[0].size >= self._most:
            self._size -= self._pieces.popleft().size

    def clear(self) -> None:
        """Forget all."""
        self._pieces.clear()
        self._size = 0

    def counts(self) -> NDArray[np.int64]:
        """How many lie in each class, shape (len(EDGES_us) - 1,)."""
        classes = np.searchsorted(EDGES_us, self._values_us(), side="right") - 1
        result: NDArray[np.int64] = np.bincount(
            np.clip(classes, 0, EDGES_us.size - 2), minlength=EDGES_us.size - 1
        ).astype(np.int64)
        return result

    def words(self) -> str:
        """Median, 99th percentile and largest."""
        values_us = self._values_us()
        if not values_us.size:
            return "no tick yet"
        p50, p99 = np.percentile(values_us, (50, 99))
        return f"p50 {_said(p50)}, p99 {_said(p99)}, max {_said(values_us.max())}"

    def _values_us(self) -> NDArray[np.float64]:
        if not self._pieces:
            return np.empty(0)
        values: NDArray[np.float64] = np.concatenate(list(self._pieces)) * 1e-3
        return values


def bars(counts: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """What a histogram is drawn from; `top` is never below the axis' beginning."""
    return {"left": EDGES_us[:-1], "right": EDGES_us[1:], "top": np.maximum(counts, LEAST), "count": counts}


def histogram(title: str, source: ColumnDataSource, period_s: float | None, colour: str, **options: Any) -> figure:  # noqa: ANN401
    """How many ticks lie in each class, and where a tick's period ends.

    Parameters
    ----------
    title
        What the durations are of.
    source
        Of `bars`.
    period_s
        Of the ticks; None where it is not known.
    colour
        Of the bars.
    options
        Of the figure: its height, its ranges.
    """
    plot = figure(
        title=title,
        x_axis_label="time [\N{MICRO SIGN}s]",
        y_axis_label="ticks",
        x_axis_type="log",
        y_axis_type="log",
        **options,
    )
    plot.quad(
        left="left",
        right="right",
        bottom=LEAST,
        top="top",
        source=source,
        color=colour,
        line_color="#fff",
        name="ticks",
    )
    if period_s is not None:
        plot.add_layout(Span(location=1e6 * period_s, dimension="height", line_color=RED, line_dash="dashed"))
    plot.xaxis.ticker = LogTicker(desired_num_ticks=6)
    return plot


def _said(value_us: float) -> str:
    return f"{value_us:.0f} \N{MICRO SIGN}s" if value_us < LONGEST_us else f"{1e-3 * value_us:.1f} ms"
