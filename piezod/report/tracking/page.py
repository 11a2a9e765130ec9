"""The page of followed references: verdict, table, and three figures for each reference."""

import html
from collections.abc import Mapping
from pathlib import Path

from bokeh.plotting import figure

from piezod.recording import Recording
from piezod.report.figures.layout import decimated, finish_figure
from piezod.report.page import Part, head_html, write_page
from piezod.report.style import BLUE, GREEN, GREY, ORANGE
from piezod.report.tracking.tracking_errors import FigureKey

COLOURS = {"gain": ORANGE, "inverse": BLUE, "extended": GREEN}
LABELS = {"gain": "plain gain", "inverse": "hysteresis inverse", "extended": "extended inverse"}


def write_tracking_page(
    path: Path, title: str, verdict: str, recordings: dict[FigureKey, Recording], table_html: str
) -> None:
    """Write the page.

    Parameters
    ----------
    title, verdict
        Heading, and the sentence below it.
    recordings
        By (reference, compensation). The compensations of a reference share its figures.
    table_html
        Table below the verdict.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    parts: list[Part] = [head_html(title, verdict), table_html]
    for reference in dict.fromkeys(key[0] for key in recordings):
        by_compensation = {key[1]: recording for key, recording in recordings.items() if key[0] == reference}
        parts.append(f"<h2>{html.escape(reference)}</h2>")
        parts.append([_over_time(by_compensation), _force_over_reference(by_compensation)])
        parts.append([_error_over_time(by_compensation)])
    write_page(path, title, parts)


def _force_over_reference(recordings: Mapping[str, Recording]) -> figure:
    plot = figure(title="Force over reference", x_axis_label="reference [N]", y_axis_label="force [N]", height=320)
    for name, recording in recordings.items():
        plot.line(
            decimated(recording.channel("reference_N")),
            decimated(recording.channel("force_N")),
            color=COLOURS[name],
            legend_label=LABELS[name],
        )
    return finish_figure(plot)


def _over_time(recordings: Mapping[str, Recording]) -> figure:
    plot = figure(title="Force over time", x_axis_label="time [s]", y_axis_label="force [N]", height=320)
    first = next(iter(recordings.values()))
    reference = decimated(first.channel("reference_N"))
    plot.line(decimated(first.time_s), reference, color=GREY, line_width=3, legend_label="reference")
    for name, recording in recordings.items():
        force = decimated(recording.channel("force_N"))
        plot.line(decimated(recording.time_s), force, color=COLOURS[name], legend_label=LABELS[name])
    return finish_figure(plot)


def _error_over_time(recordings: Mapping[str, Recording]) -> figure:
    plot = figure(title="Error: force minus reference", x_axis_label="time [s]", y_axis_label="error [N]", height=220)
    for name, recording in recordings.items():
        error = recording.channel("force_N") - recording.channel("reference_N")
        plot.line(decimated(recording.time_s), decimated(error), color=COLOURS[name], legend_label=LABELS[name])
    return finish_figure(plot)
