"""Text, JSON and page of the whiteness test of a residual."""

import html
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models.annotations import BoxAnnotation
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.diagnose.verdict.words import unit_words
from piezod.recording import Recording
from piezod.report.comparison.whiteness import WhitenessTest
from piezod.report.figures.layout import finish_figure
from piezod.report.figures.thinning import envelope, envelope_times
from piezod.report.next_step import NextStep
from piezod.report.page import Part, head_html, next_step_html, write_page
from piezod.report.style import BLUE, GREY, ORANGE

POINTS = 3000  # of a drawn curve


def whiteness_as_dict(test: WhitenessTest, recording: Recording, model: str, unit: str) -> dict[str, Any]:
    """Return the test for JSON."""
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
        "words": test.sentence,
    }


def whiteness_text(test: WhitenessTest, unit: str) -> str:
    """Format samples, residual, both correlations and the verdict as text."""
    middle = (test.cross.size - 1) // 2
    auto_lag = int(np.argmax(np.abs(test.auto[1:]))) + 1
    cross_index = int(np.argmax(np.abs(test.cross)))
    lags = test.auto.size - 1
    auto = _largest(test.auto[auto_lag], auto_lag, test.auto_bound, test.auto_outside, lags)
    cross = _largest(
        test.cross[cross_index], cross_index - middle, test.cross_bound, test.cross_outside, test.cross.size
    )
    lines = [
        f"{test.samples} samples, one lag {1e3 * test.dt_s:g} ms",
        f"residual: rms {test.rms:.4g} {unit}, mean {test.mean:+.4g} {unit}",
        f"autocorrelation: {auto}",
        f"with the input:  {cross}",
        test.sentence,
    ]
    return "\n".join(lines)


def _largest(value: float, lag: int, bound: float, outside: int, lags: int) -> str:
    return f"largest {value:+.3f} at lag {lag}, bound {bound:.4f}; {outside} of {lags} lags beyond it"


def write_whiteness_page(
    path: Path,
    test: WhitenessTest,
    recording: Recording,
    residual: Array,
    unit: str,
    step: NextStep | None = None,
) -> None:
    """Write the page: verdict, both correlations with their bounds, and the residual over time.

    Parameters
    ----------
    residual
        Measured minus modelled, shape (N,), in the output's unit.
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    lags = np.arange(test.auto.size, dtype=np.float64)
    both_signs = np.arange(test.cross.size, dtype=np.float64) - (test.cross.size - 1) // 2
    over_time = figure(
        title="Residual over time", x_axis_label="time [s]", y_axis_label=f"residual [{unit_words(unit)}]", height=240
    )
    shown_s = envelope_times(recording.time_s, POINTS)
    over_time.line(shown_s, envelope(residual, POINTS), color=ORANGE, legend_label="residual")
    auto = _stems("Autocorrelation of the residual", lags, test.auto, test.auto_bound)
    cross = _stems("Correlation of the residual with the input", both_signs, test.cross, test.cross_bound)
    note = (
        f"{test.samples} samples, one lag {1e3 * test.dt_s:g} ms; residual mean {test.mean:+.4g} {unit}. "
        "Shaded: the range of 99 % of the correlations if the residual is white and independent of the input, "
        "as in MATLAB. At positive lags the residual follows the input."
    )
    parts: list[Part] = [
        head_html("Whiteness of the residual", test.sentence),
        next_step_html(step),
        [auto, cross],
        f"<p class='dim'>{html.escape(note)}</p>",
        [finish_figure(over_time)],
    ]
    write_page(path, "Residual", parts)


def _stems(title: str, lags: Array, values: Array, bound: float) -> figure:
    plot = figure(title=title, x_axis_label="lag [samples]", y_axis_label="correlation [1]", height=300)
    plot.add_layout(BoxAnnotation(bottom=-bound, top=bound, fill_color=GREY, fill_alpha=0.25, line_color=None))
    plot.segment(lags, 0.0, lags, values, color=BLUE, line_width=2)
    plot.scatter(lags, values, color=BLUE, size=6, legend_label="correlation")
    return finish_figure(plot)
