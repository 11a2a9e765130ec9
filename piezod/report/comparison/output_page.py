"""Text, JSON and page of a comparison of simulated outputs with a measured output."""

import html
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bokeh.plotting import figure

from piezod.diagnose.verdict.words import unit_words
from piezod.report.comparison.output_comparison import Comparison, SimulatedOutput
from piezod.report.figures.layout import finish_figure
from piezod.report.figures.thinning import envelope, envelope_times, robust_range
from piezod.report.next_step import NextStep
from piezod.report.page import Part, axis_label, head_html, next_step_html, table_html, write_page
from piezod.report.ranking import gain_text, in_noises
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED
from piezod.report.text_table import text_table

COLOURS = (BLUE, ORANGE, GREEN, RED)
POINTS = 3000  # of a drawn curve
HEADER = ("", "fit, NRMSE [%]", "rms error", "max error", "gain", "offset", "fit refitted [%]")


def comparison_as_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison for JSON.

    Parameters
    ----------
    comparison
        Measured and simulated outputs with their agreement.
    """
    return {
        "schema": "piezod.comparison/1",
        "measured": comparison.measured.source,
        "output": comparison.output,
        "unit": _unit(comparison.output),
        "noise": comparison.noise,
        "compared": [{"name": output.name} | asdict(output.agreement) for output in comparison.simulated],
    }


def comparison_text(comparison: Comparison) -> str:
    """Format the comparison as text: one line for each output, then the best fit in a sentence.

    Parameters
    ----------
    comparison
        Measured and simulated outputs with their agreement.
    """
    return "\n".join([*text_table([HEADER, *_rows(comparison)]), _verdict(comparison)])


def write_comparison_page(path: Path, comparison: Comparison, step: NextStep | None = None) -> None:
    """Write the page: best fit, table, outputs and errors over time.

    Parameters
    ----------
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    note = (
        "Fit: 100 (1 - |y - yhat| / |y - mean(y)|), as in MATLAB. "
        "Fit refitted: the same after the best gain and offset are applied to the simulated output."
    )
    outputs, errors = _outputs_and_errors(comparison)
    parts: list[Part] = [
        head_html(f"Comparison with {Path(comparison.measured.source).name}", _verdict(comparison)),
        next_step_html(step),
        table_html(HEADER, _rows(comparison)),
        [outputs],
        [errors],
        f"<p class='dim'>{html.escape(note)}</p>",
    ]
    write_page(path, "Comparison", parts)


def _outputs_and_errors(comparison: Comparison) -> tuple[figure, figure]:
    recording = comparison.measured
    name = comparison.output
    y = recording.channel(name)
    shown_s = envelope_times(recording.time_s, POINTS)
    outputs = figure(title="Measured and simulated", x_axis_label="time [s]", y_axis_label=axis_label(name), height=340)
    outputs.line(shown_s, envelope(y, POINTS), color=GREY, line_width=3, legend_label="measured")
    errors = figure(
        title="Measured less simulated",
        x_axis_label="time [s]",
        y_axis_label=f"error [{unit_words(_unit(name))}]",
        height=260,
        x_range=outputs.x_range,
        y_range=robust_range(*(y - output.values for output in comparison.simulated)),
    )
    for number, output in enumerate(comparison.simulated):
        colour = COLOURS[number % len(COLOURS)]
        outputs.line(shown_s, envelope(output.values, POINTS), color=colour, legend_label=output.name)
        errors.line(shown_s, envelope(y - output.values, POINTS), color=colour, legend_label=output.name)
    return finish_figure(outputs), finish_figure(errors)


def _rows(comparison: Comparison) -> list[list[str]]:
    unit = unit_words(_unit(comparison.output))
    return [_cells(output, unit) for output in comparison.simulated]


def _cells(output: SimulatedOutput, unit: str) -> list[str]:
    agreement = output.agreement
    return [
        output.name,
        f"{agreement.nrmse_percent:.2f}",
        f"{agreement.rms:.4g} {unit}",
        f"{agreement.max:.4g} {unit}",
        f"{agreement.gain:.4f}",
        f"{agreement.offset:+.4g} {unit}",
        f"{agreement.nrmse_percent_refitted:.2f}",
    ]


def _verdict(comparison: Comparison) -> str:
    best = comparison.best
    noise, unit = comparison.noise, unit_words(_unit(comparison.output))
    sentence = f"{best.name} fits with {best.agreement.nrmse_percent:.2f} %"
    error = f"rms error {in_noises(best.agreement.rms, noise, unit)}" + (f" of {noise:.2g} {unit}" if noise else "")
    if len(comparison.simulated) == 1:
        return f"{sentence}; {error}"
    second = comparison.ranked[1].name
    gain = gain_text(best.name, second, comparison.scores, noise, unit)
    return f"{sentence}, best of {len(comparison.simulated)}; {error}; {gain}"


def _unit(column: str) -> str:
    return column.rpartition("_")[2]
