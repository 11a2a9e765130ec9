"""Output of a validation: a table, a page, and a sentence that names the better model.

The better model has the smaller rms error; of equal ones the smaller hysteresis (`report/ranking.py`).
"""

import html
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from bokeh.models import Range1d
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.estimation.recordings.noise import noise_of
from piezod.identify.scores import max_hysteresis_percent
from piezod.recording import Recording
from piezod.report.figures.layout import decimated, finish_figure, labelled_figure
from piezod.report.next_step import NextStep
from piezod.report.page import Part, table_html, write_page
from piezod.report.ranking import Score, best_of, gain_text, in_noises
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED
from piezod.report.text_table import column_widths, text_table
from piezod.report.tracking.tracking_errors import FigureKey, SessionOutcome, TrackingFigures, tracking_figures

MODEL_COLOURS = (BLUE, GREEN, RED, GREY)
TRIANGLE = ("amplitude_N", "offset_N", "frequency_Hz")  # of a reference, for JSON
COUNTED = ("ticks", "missed", "failed_exchanges", "fault", "stopped", "warnings")  # of the session, for JSON


class Triangle(Protocol):
    """A triangular force reference."""

    @property
    def amplitude_N(self) -> float:
        """Half the difference between highest and lowest force."""

    @property
    def offset_N(self) -> float:
        """Mean of highest and lowest force."""

    @property
    def frequency_Hz(self) -> float:
        """Triangles per second."""


@dataclass(frozen=True)
class ValidationVerdict:
    """Figures of a validation, and the better model.

    Parameters
    ----------
    compensations
        Names of the compensations, in the order of the table. The first uses no model.
    range_N
        Least and largest force that every model reaches [N].
    figures
        Errors by (reference, compensation), of the runs that were completed.
    noise_N
        Rms noise of the readings, from repeats of the references [N]; None: unknown.
    """

    references: Mapping[str, Triangle]
    compensations: list[str]
    range_N: tuple[float, float]
    figures: dict[FigureKey, TrackingFigures]
    outcome: SessionOutcome
    noise_N: float | None = None

    @property
    def complete(self) -> bool:
        """Whether every run was completed."""
        all_done = len(self.figures) == len(self.references) * len(self.compensations)
        return all_done and not self.outcome.fault and not self.outcome.stopped

    @property
    def mean_hysteresis_percent(self) -> dict[str, float]:
        """Mean max hysteresis over all references, for each compensation that completed every reference."""
        means = {}
        for name in self.compensations:
            of_references = [errors.max_hysteresis_percent for key, errors in self.figures.items() if key[1] == name]
            known = [percent for percent in of_references if percent is not None]
            if len(known) == len(self.references):
                means[name] = float(np.mean(known))
        return means

    @property
    def scores(self) -> dict[str, Score]:
        """Rms error and mean width of the loops [N], for each compensation that completed every reference."""
        scores = {}
        for name in self.compensations:
            of_references = [errors for key, errors in self.figures.items() if key[1] == name]
            if len(of_references) == len(self.references):
                rms_N = float(np.sqrt(np.mean([errors.rms_error_N**2 for errors in of_references])))
                scores[name] = Score(rms_N, _mean_width_N(of_references))
        return scores

    @property
    def better(self) -> str | None:
        """Name of the better model; None if the validation is not complete."""
        if not self.complete:
            return None
        scores = self.scores
        models = {name: scores[name] for name in self.compensations[1:] if name in scores}
        return best_of(models, self.noise_N) if models else None

    @property
    def better_than_none(self) -> bool:
        """Whether the better model leaves a smaller error than no model."""
        if (better := self.better) is None:
            return False
        scores = self.scores
        pair = {self.compensations[0]: scores[self.compensations[0]], better: scores[better]}
        return best_of(pair, self.noise_N) == better

    @property
    def sentence(self) -> str:
        """Verdict in a sentence."""
        runs = f"after {len(self.figures)} of {len(self.references) * len(self.compensations)} runs"
        if self.outcome.fault:
            return f"FAULT {runs}: {self.outcome.fault}"
        if (better := self.better) is None:
            return f"stopped {runs}: no verdict"
        scores, without = self.scores, self.compensations[0]
        ranked = sorted((name for name in scores if name not in {without, better}), key=lambda name: scores[name].rms)
        degree = {0: "is the only model", 1: "is the better model"}.get(len(ranked), "is the best model")
        others = "; ".join(f"{name}: {self._errors(name)}" for name in (*ranked, without))
        gain = "".join(f"; {gain_text(better, name, scores, self.noise_N, 'N')}" for name in ranked[:1])
        warning = "" if self.better_than_none else "; it is NOT better than no model"
        noise = "" if not self.noise_N else f"; noise {self.noise_N:.2g} N"
        return f"{better} {degree}: {self._errors(better)} ({others}){gain}{noise}{warning}"

    def _errors(self, name: str) -> str:
        """Rms error and hysteresis of a compensation, in noises if the noise is known."""
        score, percent = self.scores[name], self.mean_hysteresis_percent.get(name)
        rms = f"rms error {in_noises(score.rms, self.noise_N, 'N')}"
        if score.hysteresis is None or percent is None:
            return rms
        width = in_noises(score.hysteresis, self.noise_N, "N")
        return f"{rms}, mean max hysteresis {width} = {percent:.2f} %"

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "schema": "piezod.validate/1",
            "better": self.better,
            "words": self.sentence,
            "range_N": list(self.range_N),
            "mean_max_hysteresis_percent": self.mean_hysteresis_percent,
            "noise_N": self.noise_N,
            "rms_error_N": {name: score.rms for name, score in self.scores.items()},
            "mean_max_hysteresis_N": {name: score.hysteresis for name, score in self.scores.items()},
            "figures": [
                {
                    "reference": reference,
                    **{
                        key: getattr(self.references[reference], key)
                        for key in ("amplitude_N", "offset_N", "frequency_Hz")
                    },
                    "compensation": compensation,
                    **errors.as_dict(),
                }
                for (reference, compensation), errors in self.figures.items()
            ],
            **{key: getattr(self.outcome, key) for key in COUNTED},
        }


def evaluate_validation(
    references: Mapping[str, Triangle],
    compensations: list[str],
    range_N: tuple[float, float],
    recordings: dict[FigureKey, Recording],
    outcome: SessionOutcome,
) -> ValidationVerdict:
    """Compute the figures of every completed run.

    The errors use all samples. Max hysteresis leaves out the first cycle: it starts from rest, on a branch of its own.

    Parameters
    ----------
    references, compensations, range_N, outcome
        See `ValidationVerdict`.
    recordings
        Completed runs by (reference, compensation).

    Raises
    ------
    RecordingError
        A run lacks the channel `reference_N` or `force_N`.
    """
    figures = {}
    for key, recording in recordings.items():
        steady = recording.time_s >= 1.0 / references[key[0]].frequency_Hz
        reference, force = recording.channel("reference_N")[steady], recording.channel("force_N")[steady]
        hysteresis_percent = max_hysteresis_percent(reference, force)
        figures[key] = replace(tracking_figures(recording, loop=False), max_hysteresis_percent=hysteresis_percent)
    return ValidationVerdict(references, compensations, range_N, figures, outcome, _noise_N(recordings.values()))


def _noise_N(recordings: Iterable[Recording]) -> float | None:
    """Median noise of the readings over the runs whose reference repeats [N]; None: none repeats."""
    noises = []
    for recording in recordings:
        reference, force = recording.channel("reference_N"), recording.channel("force_N")
        noise = noise_of(reference, force, np.isfinite(force), recording.dt_s)
        noises += [] if noise is None else [noise.rms]
    return float(np.median(noises)) if noises else None


def _mean_width_N(figures: Sequence[TrackingFigures]) -> float | None:
    """Mean width of the widest loops [N]; None if a run closed no loop."""
    widths = [
        0.01 * errors.max_hysteresis_percent * errors.range_N
        for errors in figures
        if errors.max_hysteresis_percent is not None
    ]
    return float(np.mean(widths)) if widths and len(widths) == len(figures) else None


def validation_text(verdict: ValidationVerdict) -> str:
    """Format range, table and verdict as text, with three columns for each compensation."""
    parts = ("max hyst. [%]", "rms [N] (%)", "max [N] (%)")
    rows = [["reference", *parts * len(verdict.compensations)], *_rows(verdict)]
    widths = column_widths(rows)
    groups = [" " * widths[0]]
    for number, name in enumerate(verdict.compensations):
        width = sum(widths[1 + 3 * number : 4 + 3 * number]) + 4
        groups.append(f" {name} ".center(width, "-")[:width])
    lines = [_range_sentence(verdict), "  ".join(groups).rstrip(), *text_table(rows)]
    lines.extend(f"warning: {warning}" for warning in verdict.outcome.warnings)
    if verdict.outcome.missed or verdict.outcome.failed_exchanges:
        lines.append(f"{verdict.outcome.missed} ticks missed, {verdict.outcome.failed_exchanges} failed exchanges")
    return "\n".join([*lines, verdict.sentence])


def write_validation_page(
    path: Path, verdict: ValidationVerdict, recordings: dict[FigureKey, Recording], step: NextStep | None = None
) -> None:
    """Write the page: verdict, table, and for each reference the error and the force over the reference.

    Parameters
    ----------
    recordings
        Runs by (reference, compensation).
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    title = "Validation: error and max hysteresis with each model"
    parts = ["max hysteresis [%]", "rms error [N] (%)", "max error [N] (%)"]
    groups = [("", 1), *((name, len(parts)) for name in verdict.compensations)]
    table = table_html(["reference", *parts * len(verdict.compensations)], _rows(verdict), groups)
    shown: list[Part] = [table, f"<p class='dim'>{html.escape(_range_sentence(verdict))}</p>"]
    colours = {
        name: ORANGE if number == 0 else MODEL_COLOURS[(number - 1) % len(MODEL_COLOURS)]
        for number, name in enumerate(verdict.compensations)
    }
    runs = {
        reference: {key[1]: recording for key, recording in recordings.items() if key[0] == reference}
        for reference in dict.fromkeys(key[0] for key in recordings)
    }
    if runs:
        shown.append(_legend(colours))
    for heading, label, drawn in (
        ("Error over reference", "error [N]", _error_N),
        ("Force over reference", "force [N]", _force_N),
    ):
        if runs:
            shown += [f"<h2>{heading}</h2>", _small_multiples(runs, colours, label, drawn)]
    write_page(path, title, (title, verdict.sentence), shown, step)


def _legend(colours: Mapping[str, str]) -> str:
    entries = (
        f"<span style='color:{colour}'>\N{BLACK SQUARE}</span> {html.escape(name)}" for name, colour in colours.items()
    )
    return f"<p>{' &emsp; '.join(entries)}</p>"


def _error_N(recording: Recording) -> Array:
    return recording.channel("force_N") - recording.channel("reference_N")


def _force_N(recording: Recording) -> Array:
    return recording.channel("force_N")


def _small_multiples(
    runs: Mapping[str, Mapping[str, Recording]],
    colours: Mapping[str, str],
    label: str,
    drawn: Callable[[Recording], Array],
) -> list[figure]:
    """A small figure for each reference, with a common scale."""
    values = [drawn(recording) for by_name in runs.values() for recording in by_name.values()]
    low, high = min(float(np.nanmin(curve)) for curve in values), max(float(np.nanmax(curve)) for curve in values)
    margin = 0.05 * (high - low)
    shared = Range1d(start=low - margin, end=high + margin)
    plots = []
    for reference, by_name in runs.items():
        plot = labelled_figure(reference, "reference [N]", label, 230, y_range=shared)
        for name, recording in by_name.items():
            plot.line(decimated(recording.channel("reference_N")), decimated(drawn(recording)), color=colours[name])
        plots.append(finish_figure(plot))
    return plots


def _range_sentence(verdict: ValidationVerdict) -> str:
    low_N, high_N = verdict.range_N
    frequency_Hz = next(iter(verdict.references.values())).frequency_Hz
    return (
        f"triangles of {frequency_Hz:g} Hz; every model reaches {low_N:.1f} to {high_N:.1f} N; "
        "percentages are of the range of each reference; hysteresis is without the first cycle, which starts from rest"
    )


def _rows(verdict: ValidationVerdict) -> list[list[str]]:
    rows = []
    for reference in verdict.references:
        cells = [reference]
        for name in verdict.compensations:
            cells.extend(_cells(verdict.figures.get((reference, name))))
        rows.append(cells)
    means = verdict.mean_hysteresis_percent
    last = ["mean"]
    for name in verdict.compensations:
        last.extend((f"{means[name]:.2f}" if name in means else "-", "", ""))
    return [*rows, last]


def _cells(errors: TrackingFigures | None) -> tuple[str, str, str]:
    if errors is None:
        return "-", "-", "-"
    return (
        "-" if errors.max_hysteresis_percent is None else f"{errors.max_hysteresis_percent:.2f}",
        f"{errors.rms_error_N:.2f} ({errors.rms_error_percent:.2f})",
        f"{errors.max_error_N:.2f} ({errors.max_error_percent:.2f})",
    )
