"""The demo's output: a line of live values, a table, the verdicts, and a page."""

import contextlib
import html
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.control import State
from piezod.recording import Recording
from piezod.report.figures.layout import decimated, finish_figure, labelled_figure
from piezod.report.page import Part, table_html, write_page
from piezod.report.style import BLUE, GREEN, GREY, ORANGE
from piezod.report.text_table import text_table
from piezod.report.tracking.hidden import ERRORS_HEADER, HiddenVerdict, hidden_html
from piezod.report.tracking.tracking_errors import LABELS, FigureKey, SessionOutcome, TrackingFigures, tracking_figures

MOST_HYSTERESIS = 0.25  # compensated over uncompensated max hysteresis at which the demo passes
ONE_SECOND_ns = 1_000_000_000
HEADER = ["reference", *ERRORS_HEADER, "max hysteresis [%]"]
COLOURS = {"gain": ORANGE, "inverse": BLUE, "extended": GREEN}

Rows = NDArray[np.void]


class Timing(Protocol):
    """Percentiles of the tick timing [us]."""

    @property
    def lateness_us(self) -> dict[str, float]:
        """Delay of the wake-ups after their deadlines."""

    @property
    def completion_us(self) -> dict[str, float]:
        """Time from the deadline to the committed state."""


@dataclass(frozen=True)
class DemoVerdict:
    """Figures of the demo and whether it passed.

    Parameters
    ----------
    figures
        Errors by (reference, compensation).
    timing
        Percentiles of the tick timing.
    hidden
        Result on the bench with hidden effects; None if that part did not run.
    """

    figures: dict[FigureKey, TrackingFigures]
    timing: Timing
    outcome: SessionOutcome
    hidden: HiddenVerdict | None = None

    @property
    def hysteresis_ratio(self) -> float:
        """Compensated over uncompensated max hysteresis on the triangle; nan if either is missing."""
        with_inverse = self.figures.get(("triangle", "inverse"))
        with_gain = self.figures.get(("triangle", "gain"))
        if with_inverse is None or with_gain is None or not with_gain.max_hysteresis_percent:
            return float("nan")
        return (with_inverse.max_hysteresis_percent or 0.0) / with_gain.max_hysteresis_percent

    @property
    def passed(self) -> bool:
        """Whether at most a quarter of the hysteresis remains, no exchange failed, and `hidden` passed."""
        clean = not self.outcome.failed_exchanges and not self.outcome.fault and not self.outcome.stopped
        return clean and self.hysteresis_ratio <= MOST_HYSTERESIS and (self.hidden is None or self.hidden.passed)

    @property
    def sentence(self) -> str:
        """Verdict in a sentence."""
        if self.outcome.stopped:
            return "stopped: ramped down before the end"
        if self.outcome.fault:
            return f"FAULT: {self.outcome.fault}"
        if self.outcome.failed_exchanges:
            return f"{self.outcome.failed_exchanges} exchanges failed: {self.outcome.results}"
        gain = self.figures["triangle", "gain"].max_hysteresis_percent
        inverse = self.figures["triangle", "inverse"].max_hysteresis_percent
        return (
            f"hysteresis {gain:.2f} % -> {inverse:.2f} % of range: {self.hysteresis_ratio:.0%} of it remains "
            f"({'at most' if self.passed else 'NOT below'} {MOST_HYSTERESIS:.0%})"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the result for JSON."""
        return {
            "schema": "piezod.demo/1",
            "hidden": None if self.hidden is None else self.hidden.as_dict(),
            "passed": self.passed,
            "words": self.sentence,
            "figures": [
                {"reference": reference, "compensation": compensation, **errors.as_dict()}
                for (reference, compensation), errors in self.figures.items()
            ],
            "ticks": self.outcome.ticks,
            "missed": self.outcome.missed,
            "failed_exchanges": self.outcome.failed_exchanges,
            "lateness_us": self.timing.lateness_us,
            "completion_us": self.timing.completion_us,
            "resident_kib": self.outcome.resident_kib,
            "warnings": self.outcome.warnings,
        }


def evaluate_demo(recordings: dict[FigureKey, Recording], timing: Timing, outcome: SessionOutcome) -> DemoVerdict:
    """Compute the figures of every reference that was followed.

    Parameters
    ----------
    recordings
        By (reference, compensation).
    timing, outcome
        Timing and counters of the control process.
    """
    figures = {
        key: tracking_figures(recording, loop=key[0] == "triangle")
        for key, recording in recordings.items()
        if recording.time_s.size > 1
    }
    return DemoVerdict(figures, timing, outcome)


@contextlib.contextmanager
def live_line(names: list[str]) -> Iterator[Callable[[Rows], None]]:
    """Yield a function that prints the newest of the given ring-log rows.

    On a terminal it overwrites one line; elsewhere it prints one line a second.

    Parameters
    ----------
    names
        Names of the segments, by their number. The list may grow meanwhile.
    """
    terminal = sys.stdout.isatty()
    last_ns = 0

    def show(rows: Rows) -> None:
        nonlocal last_ns
        if not len(rows) or (not terminal and int(rows["time_ns"][-1]) - last_ns < ONE_SECOND_ns):
            return
        row = rows[-1]
        last_ns = int(row["time_ns"])
        state, number = State(row["state"]), int(row["segment"])
        error = row["force_N"] - row["reference_N"] if state is State.RUNNING else float("nan")
        text = (
            f"{state.name:9} {names[number] if 0 <= number < len(names) else '':20} "
            f"reference {row['reference_N']:7.2f} N  force {row['force_N']:7.2f} N  error {error:+6.2f} N  "
            f"late {rows['lateness_ns'].max() / 1000:5.0f} us"
        )
        print(f"\r{text}\x1b[K" if terminal else text, end="" if terminal else "\n", flush=True)

    yield show
    if terminal:
        print("\r\x1b[K", end="", flush=True)


def print_demo(verdict: DemoVerdict) -> None:
    """Print table, timing, warnings and verdict."""
    print("\n".join(text_table([HEADER, *_rows(verdict)], left_aligned=2)))
    print(_timing_sentence(verdict))
    for warning in verdict.outcome.warnings:
        print(f"warning: {warning}")
    print(verdict.sentence)


def write_demo_page(path: Path, verdict: DemoVerdict, recordings: dict[FigureKey, Recording]) -> None:
    """Write the page of the demo.

    Parameters
    ----------
    recordings
        By (reference, compensation). Recordings of a single sample are skipped.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    shown = {key: recording for key, recording in recordings.items() if recording.time_s.size > 1}
    table = table_html(HEADER, _rows(verdict)) + f"<p>{_timing_sentence(verdict)}</p>"
    if verdict.hidden is not None:
        table += hidden_html(verdict.hidden)
    title = "Demo: the force follows a reference"
    parts: list[Part] = [table]
    for reference in dict.fromkeys(key[0] for key in shown):
        by_compensation = {key[1]: recording for key, recording in shown.items() if key[0] == reference}
        parts.append(f"<h2>{html.escape(reference)}</h2>")
        parts.append([_over_time(by_compensation), _force_over_reference(by_compensation)])
        parts.append([_error_over_time(by_compensation)])
    write_page(path, title, (title, verdict.sentence), parts)


def _rows(verdict: DemoVerdict) -> list[list[str]]:
    return [
        [
            reference,
            LABELS[compensation],
            *errors.cells,
            "-" if errors.max_hysteresis_percent is None else f"{errors.max_hysteresis_percent:.2f}",
        ]
        for (reference, compensation), errors in verdict.figures.items()
    ]


def _timing_sentence(verdict: DemoVerdict) -> str:
    late = verdict.timing.lateness_us
    return (
        f"{verdict.outcome.ticks} ticks, {verdict.outcome.missed} missed, {verdict.outcome.failed_exchanges} failed "
        f"exchanges; lateness p50 {late['p50']:.0f} us, p99 {late['p99']:.0f} us, p99.9 {late['p99.9']:.0f} us"
    )


def _force_over_reference(recordings: Mapping[str, Recording]) -> figure:
    plot = labelled_figure("Force over reference", "reference [N]", "force [N]", 320)
    for name, recording in recordings.items():
        plot.line(
            decimated(recording.channel("reference_N")),
            decimated(recording.channel("force_N")),
            color=COLOURS[name],
            legend_label=LABELS[name],
        )
    return finish_figure(plot)


def _over_time(recordings: Mapping[str, Recording]) -> figure:
    plot = labelled_figure("Force over time", "time [s]", "force [N]", 320)
    first = next(iter(recordings.values()))
    reference = decimated(first.channel("reference_N"))
    plot.line(decimated(first.time_s), reference, color=GREY, line_width=3, legend_label="reference")
    for name, recording in recordings.items():
        force = decimated(recording.channel("force_N"))
        plot.line(decimated(recording.time_s), force, color=COLOURS[name], legend_label=LABELS[name])
    return finish_figure(plot)


def _error_over_time(recordings: Mapping[str, Recording]) -> figure:
    plot = labelled_figure("Error: force minus reference", "time [s]", "error [N]", 220)
    for name, recording in recordings.items():
        error = recording.channel("force_N") - recording.channel("reference_N")
        plot.line(decimated(recording.time_s), decimated(error), color=COLOURS[name], legend_label=LABELS[name])
    return finish_figure(plot)
