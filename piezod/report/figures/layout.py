"""Width, toolbar, legend and axis ticks that the figures of all pages share."""

from typing import Any

import numpy as np
from bokeh.models import BasicTicker, HoverTool, LogTicker
from bokeh.plotting import figure
from numpy.typing import NDArray

AXIS_WIDTH = 70  # [px]: figures below each other begin at one place
MOST_TICKS = 5  # more labels overlap on a telephone
MOST_IN_A_ROW = 3  # entries of a legend in one row; more are cut off on a telephone
SHOWN_SAMPLES = 1500  # points of a decimated curve; tables use all samples


def decimated(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return every n-th sample, with n such that about `SHOWN_SAMPLES` remain.

    Parameters
    ----------
    values
        Record, shape (N,).
    """
    return values[:: max(1, values.size // SHOWN_SAMPLES)]


def labelled_figure(title: str, x: str, y: str, height: int, **options: Any) -> figure:  # noqa: ANN401
    """Figure with labels of its axes.

    Parameters
    ----------
    title, x, y
        Title, and labels of the axes with their units.
    height
        Height [px].
    options
        Further Bokeh properties, such as ranges and kinds of axes.
    """
    return figure(title=title, x_axis_label=x, y_axis_label=y, height=height, **options)


def apply_layout(plot: figure, **legend: Any) -> figure:  # noqa: ANN401
    """Set width, toolbar and legend of a figure in place, and return it.

    Parameters
    ----------
    legend
        Bokeh properties of the legend that replace or extend the shared ones.
    """
    plot.sizing_mode = "stretch_width"
    plot.toolbar.autohide = True
    plot.toolbar.logo = None
    if plot.legend:
        shared = {
            "orientation": "horizontal",
            "border_line_color": None,
            "click_policy": "hide",
            "label_text_font_size": "11px",
            "margin": 0,
            "padding": 2,
        }
        if len(plot.legend[0].items) > MOST_IN_A_ROW:
            shared["ncols"] = 2
        plot.legend[0].update(**(shared | legend))
        plot.add_layout(plot.legend[0], "above")
    return plot


def finish_figure(plot: figure) -> figure:
    """Add layout, few ticks and a tooltip to a figure of a report, and return it."""
    apply_layout(plot, spacing=8, glyph_height=14, label_height=14)
    if not isinstance(plot.xaxis[0].ticker, LogTicker):
        plot.xaxis.ticker = BasicTicker(desired_num_ticks=MOST_TICKS)
    plot.min_border_left = AXIS_WIDTH
    plot.add_tools(HoverTool(tooltips=[("x", "$x{0.000}"), ("y", "$y{0.00}")]))
    return plot
