"""What a comparison and a test of residuals say: text for a terminal, and one page each."""

import html
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models.annotations import BoxAnnotation
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.diagnose.words import unit_words
from piezod.recording import Recording
from piezod.report.comparison.output_comparison import Candidate, Comparison
from piezod.report.comparison.whiteness import ResidualTest
from piezod.report.figures.thinning import envelope, envelope_times
from piezod.report.page import Part, axis_label, head_html, table_html, write_page
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED
from piezod.report.tracking.page import finish

Array = NDArray[np.float64]

COLOURS = (BLUE, ORANGE, GREEN, RED)
POINTS = 3000
HEADER = ("", "fit, NRMSE [%]", "rms error", "max error", "gain", "offset", "fit refitted [%]")


def comparison_as_dict(comparison: Comparison) -> dict[str, Any]:
    """For JSON."""
    return {
        "schema": "piezod.comparison/1",
        "measured": comparison.measured.source,
        "output": comparison.output,
        "unit": _unit(comparison.output),
        "compared": [{"name": one.name} | asdict(one.agreement) for one in comparison.candidates],
    }


def comparison_text(comparison: Comparison) -> str:
    """A line each, the best fit last in words."""
    rows = [list(HEADER), *_rows(comparison)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEADER))]
    lines = [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in rows
    ]
    return "\n".join([*lines, _verdict(comparison)])


def write_comparison_page(path: Path, comparison: Comparison) -> None:
    """One page: the verdict, the table, outputs and errors over time.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    recording, name = comparison.measured, comparison.output
    time_s, y = recording.time_s, recording.channel(name)
    shown_s = envelope_times(time_s, POINTS)
    outputs = figure(title="Measured and simulated", x_axis_label="time [s]", y_axis_label=axis_label(name), height=340)
    outputs.line(shown_s, envelope(y, POINTS), color=GREY, line_width=3, legend_label="measured")
    errors = figure(
        title="Measured less simulated",
        x_axis_label="time [s]",
        y_axis_label=f"error [{unit_words(_unit(name))}]",
        height=260,
        x_range=outputs.x_range,
    )
    for candidate, colour in zip(comparison.candidates, _colours(comparison), strict=True):
        outputs.line(shown_s, envelope(candidate.values, POINTS), color=colour, legend_label=candidate.name)
        errors.line(shown_s, envelope(y - candidate.values, POINTS), color=colour, legend_label=candidate.name)
    said = (
        "Fit: 100 (1 - |y - yhat| / |y - mean(y)|), as in MATLAB; refitted: with the gain and the offset that fit best."
    )
    parts: list[Part] = [
        head_html(f"Comparison with {recording.source}", _verdict(comparison)),
        table_html(HEADER, _rows(comparison)),
        [finish(outputs)],
        [finish(errors)],
        f"<p class='dim'>{html.escape(said)}</p>",
    ]
    write_page(path, "Comparison", parts)


def residual_as_dict(test: ResidualTest, recording: Recording, model: str, unit: str) -> dict[str, Any]:
    """For JSON."""
    lags = test.auto.size - 1
    return {
        "schema": "piezod.residual/1",
        "recording": recording.source,
        "model": model,
        "unit": unit,
        "samples": test.samples,
        "mean": test.mean,
        "rms": test.rms,
        "lag_s": test.dt_s,
        "confidence": 0.99,
        "auto": {"lags": list(range(lags + 1)), "values": test.auto.tolist(), "bound": test.auto_bound},
        "cross": {"lags": list(range(-lags, lags + 1)), "values": test.cross.tolist(), "bound": test.cross_bound},
        "auto_outside": test.auto_outside,
        "cross_outside": test.cross_outside,
        "words": test.words,
    }


def residual_text(test: ResidualTest, unit: str) -> str:
    """The verdict and the figures it rests on."""
    middle = (test.cross.size - 1) // 2
    largest = int(np.argmax(np.abs(test.auto[1:]))) + 1
    widest = int(np.argmax(np.abs(test.cross)))
    auto = _beyond(test.auto[largest], largest, test.auto_bound, test.auto_outside, test.auto.size - 1)
    cross = _beyond(test.cross[widest], widest - middle, test.cross_bound, test.cross_outside, test.cross.size)
    lines = [
        f"{test.samples} samples, one lag {1e3 * test.dt_s:g} ms",
        f"residual: rms {test.rms:.4g} {unit}, mean {test.mean:+.4g} {unit}",
        f"autocorrelation: {auto}",
        f"with the input:  {cross}",
        test.words,
    ]
    return "\n".join(lines)


def _beyond(value: float, lag: int, bound: float, outside: int, of: int) -> str:
    return f"largest {value:+.3f} at lag {lag}, bound {bound:.4f}; {outside} of {of} lags beyond it"


def write_residual_page(path: Path, test: ResidualTest, recording: Recording, residual: Array, unit: str) -> None:
    """One page: the verdict, both correlations with their bounds, and the residual over time.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    lags = np.arange(test.auto.size, dtype=np.float64)
    both = np.arange(test.cross.size, dtype=np.float64) - (test.cross.size - 1) // 2
    over_time = figure(
        title="Residual over time", x_axis_label="time [s]", y_axis_label=f"residual [{unit_words(unit)}]", height=240
    )
    over_time.line(
        envelope_times(recording.time_s, POINTS), envelope(residual, POINTS), color=ORANGE, legend_label="residual"
    )
    auto = _stems("Autocorrelation of the residual", lags, test.auto, test.auto_bound)
    cross = _stems("Correlation of the residual with the input", both, test.cross, test.cross_bound)
    said = (
        f"{test.samples} samples, one lag {1e3 * test.dt_s:g} ms; residual mean {test.mean:+.4g} {unit}. Shaded: "
        "where 99 % would lie if the residual were white and independent of the input, as MATLAB has it. At "
        "positive lags it follows the input."
    )
    parts: list[Part] = [
        head_html("What the model leaves", test.words),
        [auto, cross],
        f"<p class='dim'>{html.escape(said)}</p>",
        [finish(over_time)],
    ]
    write_page(path, "Residual", parts)


def _stems(title: str, lags: Array, values: Array, bound: float) -> figure:
    plot = figure(title=title, x_axis_label="lag [samples]", y_axis_label="correlation [1]", height=300)
    plot.add_layout(BoxAnnotation(bottom=-bound, top=bound, fill_color=GREY, fill_alpha=0.25, line_color=None))
    plot.segment(lags, 0.0, lags, values, color=BLUE, line_width=2)
    plot.scatter(lags, values, color=BLUE, size=6, legend_label="correlation")
    return finish(plot)


def _rows(comparison: Comparison) -> list[list[str]]:
    unit = unit_words(_unit(comparison.output))
    return [_cells(one, unit) for one in comparison.candidates]


def _cells(one: Candidate, unit: str) -> list[str]:
    figures = one.agreement
    return [
        one.name,
        f"{figures.nrmse_percent:.2f}",
        f"{figures.rms:.4g} {unit}",
        f"{figures.max:.4g} {unit}",
        f"{figures.gain:.4f}",
        f"{figures.offset:+.4g} {unit}",
        f"{figures.nrmse_percent_refitted:.2f}",
    ]


def _verdict(comparison: Comparison) -> str:
    best = comparison.best
    said = f"{best.name} fits with {best.agreement.nrmse_percent:.2f} %"
    if len(comparison.candidates) > 1:
        return f"{said}, best of {len(comparison.candidates)}"
    return said


def _colours(comparison: Comparison) -> list[str]:
    return [COLOURS[k % len(COLOURS)] for k in range(len(comparison.candidates))]


def _unit(column: str) -> str:
    return column.rpartition("_")[2]
