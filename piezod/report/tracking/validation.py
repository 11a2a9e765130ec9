"""What a validation says: one table, one page, and in words which model follows forces better."""

import html
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from bokeh.plotting import figure

from piezod.identify.scores import max_hysteresis_percent
from piezod.recording import Recording
from piezod.report.page import Part, head_html, table_html, write_page
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED
from piezod.report.tracking.demo import SessionOutcome
from piezod.report.tracking.page import TrackingFigures, finish, loop_figure, thin, tracking_figures

MODEL_COLOURS = (BLUE, GREEN, RED, GREY)


class Triangle(Protocol):
    """A triangular force reference."""

    @property
    def amplitude_N(self) -> float:
        """Half of what it spans."""
        ...

    @property
    def offset_N(self) -> float:
        """What it swings about."""
        ...

    @property
    def frequency_Hz(self) -> float:
        """Triangles a second."""
        ...


@dataclass(frozen=True)
class ValidationVerdict:
    """The figures of a validation.

    Parameters
    ----------
    references
        By name.
    compensations
        Columns of the table; the first is the one without a model.
    range_N
        Forces that all models reach.
    figures
        By (reference, compensation), of the runs that reached their end.
    outcome
        What the control process counted.
    """

    references: Mapping[str, Triangle]
    compensations: list[str]
    range_N: tuple[float, float]
    figures: dict[tuple[str, str], TrackingFigures]
    outcome: SessionOutcome

    @property
    def complete(self) -> bool:
        """Whether every run reached its end."""
        whole = len(self.figures) == len(self.references) * len(self.compensations)
        return whole and not self.outcome.fault and not self.outcome.stopped

    @property
    def mean_hysteresis_percent(self) -> dict[str, float]:
        """Mean of the references' max hysteresis, for every compensation that followed all of them."""
        means = {}
        for name in self.compensations:
            openings = [self.figures[key].max_hysteresis_percent for key in self.figures if key[1] == name]
            known = [opening for opening in openings if opening is not None]
            if len(known) == len(self.references):
                means[name] = float(np.mean(known))
        return means

    @property
    def better(self) -> str | None:
        """The model with the lowest mean of max hysteresis; None when the runs are not complete."""
        if not self.complete:
            return None
        means = self.mean_hysteresis_percent
        return min((name for name in self.compensations[1:] if name in means), key=means.__getitem__, default=None)

    @property
    def words(self) -> str:
        """The verdict in a sentence."""
        runs = f"after {len(self.figures)} of {len(self.references) * len(self.compensations)} runs"
        if self.outcome.fault:
            return f"FAULT {runs}: {self.outcome.fault}"
        if self.better is None:
            return f"stopped {runs}: no verdict"
        means = self.mean_hysteresis_percent
        without = self.compensations[0]
        ranked = sorted((name for name in means if name not in {without, self.better}), key=means.__getitem__)
        others = [f"{name}: {means[name]:.2f} %" for name in (*ranked, without)]
        degree = {0: "is the only model", 1: "is the better model"}.get(len(ranked), "is the best model")
        warning = "" if means[self.better] < means[without] else "; it does NOT do better than no model"
        return (
            f"{self.better} {degree}: mean of max hysteresis {means[self.better]:.2f} % ({', '.join(others)}){warning}"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "schema": "piezod.validate/1",
            "better": self.better,
            "words": self.words,
            "range_N": list(self.range_N),
            "mean_max_hysteresis_percent": self.mean_hysteresis_percent,
            "figures": [
                {
                    "reference": key[0],
                    "amplitude_N": self.references[key[0]].amplitude_N,
                    "offset_N": self.references[key[0]].offset_N,
                    "frequency_Hz": self.references[key[0]].frequency_Hz,
                    "compensation": key[1],
                    **one.as_dict(),
                }
                for key, one in self.figures.items()
            ],
            "ticks": self.outcome.ticks,
            "missed": self.outcome.missed,
            "failed_exchanges": self.outcome.failed_exchanges,
            "fault": self.outcome.fault,
            "stopped": self.outcome.stopped,
            "warnings": self.outcome.warnings,
        }


def judge_validation(
    references: Mapping[str, Triangle],
    compensations: list[str],
    range_N: tuple[float, float],
    recordings: dict[tuple[str, str], Recording],
    outcome: SessionOutcome,
) -> ValidationVerdict:
    """Figures of every run that reached its end: errors over all of it, max hysteresis without the first cycle.

    That one comes from rest, along a branch that the others do not return to.
    """
    figures = {}
    for key, recording in recordings.items():
        steady = recording.time_s >= 1.0 / references[key[0]].frequency_Hz
        reference, force = recording.channel("reference_N")[steady], recording.channel("force_N")[steady]
        opening = max_hysteresis_percent(reference, force)
        figures[key] = replace(tracking_figures(recording, loop=False), max_hysteresis_percent=opening)
    return ValidationVerdict(references, compensations, range_N, figures, outcome)


def validation_text(verdict: ValidationVerdict) -> str:
    """Range, table and verdict as text; three columns a compensation."""
    parts = ("max hyst. [%]", "rms [N] (%)", "max [N] (%)")
    rows = [["reference", *parts * len(verdict.compensations)], *_rows(verdict)]
    widths = [max(len(line[k]) for line in rows) for k in range(len(rows[0]))]
    groups = [" " * widths[0]]
    for number, name in enumerate(verdict.compensations):
        width = sum(widths[1 + 3 * number : 4 + 3 * number]) + 4
        groups.append(f" {name} ".center(width, "-")[:width])
    lines = [_common_range(verdict), "  ".join(groups).rstrip()]
    for cells in rows:
        padded = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
        lines.append("  ".join([cells[0].ljust(widths[0]), *padded]).rstrip())
    lines.extend(f"warning: {warning}" for warning in verdict.outcome.warnings)
    if verdict.outcome.missed or verdict.outcome.failed_exchanges:
        lines.append(f"{verdict.outcome.missed} ticks missed, {verdict.outcome.failed_exchanges} failed exchanges")
    return "\n".join([*lines, verdict.words])


def write_validation_page(path: Path, verdict: ValidationVerdict, recordings: dict[tuple[str, str], Recording]) -> None:
    """One page: the verdict, the table, and for every reference its loops and what is left of them.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    title = "Which model a force follows better"
    parts = ["max hysteresis [%]", "rms error [N] (%)", "max error [N] (%)"]
    groups = [("", 1), *((name, len(parts)) for name in verdict.compensations)]
    table = table_html(["reference", *parts * len(verdict.compensations)], _rows(verdict), groups)
    shown: list[Part] = [
        head_html(title, verdict.words),
        table,
        f"<p class='dim'>{html.escape(_common_range(verdict))}</p>",
    ]
    colours = {
        name: ORANGE if number == 0 else MODEL_COLOURS[(number - 1) % len(MODEL_COLOURS)]
        for number, name in enumerate(verdict.compensations)
    }
    labels = {name: name for name in verdict.compensations}
    for reference in verdict.references:
        chosen = {key[1]: recording for key, recording in recordings.items() if key[0] == reference}
        if chosen:
            shown.append(f"<h2>{html.escape(reference)}</h2>")
            shown.append([loop_figure(chosen, colours, labels, downwards=True), _error_loops(chosen, colours)])
    write_page(path, title, shown)


def _common_range(verdict: ValidationVerdict) -> str:
    low_N, high_N = verdict.range_N
    frequency_Hz = next(iter(verdict.references.values())).frequency_Hz
    return (
        f"triangles of {frequency_Hz:g} Hz within {low_N:.1f} to {high_N:.1f} N, which every model reaches; "
        "% of each reference's range; hysteresis without the first cycle, which comes from rest"
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


def _cells(one: TrackingFigures | None) -> tuple[str, str, str]:
    if one is None:
        return "-", "-", "-"
    return (
        "-" if one.max_hysteresis_percent is None else f"{one.max_hysteresis_percent:.2f}",
        f"{one.rms_error_N:.2f} ({one.rms_error_percent:.2f})",
        f"{one.max_error_N:.2f} ({one.max_error_percent:.2f})",
    )


def _error_loops(recordings: dict[str, Recording], colours: dict[str, str]) -> figure:
    plot = figure(title="Error over reference", x_axis_label="reference [N]", y_axis_label="error [N]", height=320)
    for name, recording in recordings.items():
        reference = recording.channel("reference_N")
        error = recording.channel("force_N") - reference
        plot.line(thin(reference), thin(error), color=colours[name], legend_label=name)
    return finish(plot, downwards=True)
