"""How well a force reference was followed: the figures, and the page that shows them."""

import html
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from bokeh.models import BasicTicker, HoverTool, LogTicker
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.identify.scores import largest, max_hysteresis_percent, rms
from piezod.recording import Recording
from piezod.report.page import Part, head_html, write_page
from piezod.report.style import BLUE, GREEN, GREY, ORANGE

MOST_TICKS = 5  # whose numbers stay apart on a telephone
SHOWN_SAMPLES = 1500  # a curve needs no more on a screen; the figures of the table use all samples


@dataclass(frozen=True)
class TrackingFigures:
    """Errors of one followed reference; percentages refer to the reference's range."""

    samples: int
    range_N: float
    rms_error_N: float
    rms_error_percent: float
    max_error_N: float
    max_error_percent: float
    max_hysteresis_percent: float | None

    def as_dict(self) -> dict[str, float | int | None]:
        """For JSON."""
        return asdict(self)


def tracking_figures(recording: Recording, *, loop: bool) -> TrackingFigures:
    """Judge a recording with `reference_N` and `force_N`.

    Parameters
    ----------
    recording
        What was followed and measured.
    loop
        Whether the reference runs up and down the same way, so that a hysteresis loop is defined.
    """
    reference, force = recording.channel("reference_N"), recording.channel("force_N")
    error = force - reference
    range_N = float(np.ptp(reference))
    return TrackingFigures(
        samples=int(force.size),
        range_N=range_N,
        rms_error_N=rms(error),
        rms_error_percent=100 * rms(error) / range_N,
        max_error_N=largest(error),
        max_error_percent=100 * largest(error) / range_N,
        max_hysteresis_percent=_opening(reference, force) if loop else None,
    )


def _opening(reference: NDArray[np.float64], force: NDArray[np.float64]) -> float | None:
    """Of a run that was stopped before its reference came back there is none."""
    try:
        return max_hysteresis_percent(reference, force)
    except ValueError:
        return None


def write_tracking_page(
    path: Path, title: str, verdict: str, recordings: dict[tuple[str, str], Recording], table_html: str
) -> None:
    """One page: the verdict in words, the table, and a row of figures for every reference.

    Parameters
    ----------
    path
        The page.
    title, verdict
        Its head line and the sentence below.
    recordings
        By (reference, compensation); compensations of one reference share its figures.
    table_html
        Shown below the verdict.
    """
    parts: list[Part] = [head_html(title, verdict), table_html]
    for reference in dict.fromkeys(key[0] for key in recordings):
        chosen = {key[1]: value for key, value in recordings.items() if key[0] == reference}
        parts.append(f"<h2>{html.escape(reference)}</h2>")
        parts.append([_over_time(chosen), loop_figure(chosen, COLOURS, LABELS)])
        parts.append([_errors(chosen)])
    write_page(path, title, parts)


COLOURS = {"gain": ORANGE, "inverse": BLUE, "extended": GREEN}
LABELS = {"gain": "plain gain", "inverse": "hysteresis inverse", "extended": "extended inverse"}


def thin(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Every so many samples, as many as a screen shows."""
    return values[:: max(1, values.size // SHOWN_SAMPLES)]


def _over_time(recordings: dict[str, Recording]) -> figure:
    plot = figure(title="Force over time", x_axis_label="time [s]", y_axis_label="force [N]", height=320)
    first = next(iter(recordings.values()))
    plot.line(
        thin(first.time_s), thin(first.channel("reference_N")), color=GREY, line_width=3, legend_label="reference"
    )
    for name, recording in recordings.items():
        plot.line(
            thin(recording.time_s), thin(recording.channel("force_N")), color=COLOURS[name], legend_label=LABELS[name]
        )
    return finish(plot)


def loop_figure(
    recordings: dict[str, Recording], colours: dict[str, str], labels: dict[str, str], *, downwards: bool = False
) -> figure:
    """Force over reference, one curve a compensation."""
    plot = figure(title="Force over reference", x_axis_label="reference [N]", y_axis_label="force [N]", height=320)
    for name, recording in recordings.items():
        plot.line(
            thin(recording.channel("reference_N")),
            thin(recording.channel("force_N")),
            color=colours[name],
            legend_label=labels[name],
        )
    return finish(plot, downwards=downwards)


def _errors(recordings: dict[str, Recording]) -> figure:
    plot = figure(title="Error: force minus reference", x_axis_label="time [s]", y_axis_label="error [N]", height=220)
    for name, recording in recordings.items():
        error = recording.channel("force_N") - recording.channel("reference_N")
        plot.line(thin(recording.time_s), thin(error), color=COLOURS[name], legend_label=LABELS[name])
    return finish(plot)


def finish(plot: figure, *, downwards: bool = False) -> figure:
    """Legend, tools and width that all figures share; a legend of long names had better run downwards."""
    plot.sizing_mode = "stretch_width"
    plot.toolbar.autohide = True
    plot.toolbar.logo = None
    if plot.legend:
        plot.legend.orientation = "vertical" if downwards else "horizontal"
        plot.legend.border_line_color = None
        plot.legend.click_policy = "hide"
        plot.legend.label_text_font_size = "11px"
        plot.legend[0].update(margin=0, padding=2, spacing=0 if downwards else 8, glyph_height=14, label_height=14)
        plot.add_layout(plot.legend[0], "above")
    if not isinstance(plot.xaxis[0].ticker, LogTicker):
        plot.xaxis.ticker = BasicTicker(desired_num_ticks=MOST_TICKS)
    plot.add_tools(HoverTool(tooltips=[("x", "$x{0.000}"), ("y", "$y{0.00}")]))
    return plot
