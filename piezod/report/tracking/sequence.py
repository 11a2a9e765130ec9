"""Verdict of a test sequence: text, JSON, JUnit XML, and a page."""

import html
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from math import isfinite
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from bokeh.plotting import figure

from piezod.config.sequence import SequenceStep, TestSequence
from piezod.identify.scores import max_hysteresis_percent
from piezod.recording import Recording
from piezod.report.figures.layout import decimated, finish_figure, labelled_figure
from piezod.report.next_step import NextStep
from piezod.report.page import Part, table_html, write_page
from piezod.report.style import BLUE, GREY, ORANGE
from piezod.report.text_table import text_table
from piezod.report.tracking.tracking_errors import SessionOutcome, tracking_figures

UNITS = {
    "rms_error_N": "N",
    "max_error_N": "N",
    "max_hysteresis_percent": "%",
    "lowest_force_N": "N",
    "highest_force_N": "N",
    "missed_ticks": "",
    "failed_exchanges": "",
}
AT_LEAST = ("lowest_force_N",)  # limits that a value must not be below; it must not be above the others
HEADER = ("step", "figure", "measured", "limit", "result")

Result = Literal["passed", "FAILED", "not run"]


class StepRun(Protocol):
    """Measurements of a step."""

    @property
    def recording(self) -> Recording:
        """Reference and force while the reference was followed."""

    @property
    def complete(self) -> bool:
        """Whether the reference reached its end."""

    @property
    def missed(self) -> int:
        """Number of missed ticks."""

    @property
    def failed_exchanges(self) -> int:
        """Number of failed exchanges."""


@dataclass(frozen=True)
class LimitResult:
    """One limit of a step with its measured value; None: not measured."""

    step: str
    name: str
    limit: float
    value: float | None

    @property
    def result(self) -> Result:
        """Whether the value keeps the limit; a value that is not finite fails."""
        if self.value is None:
            return "not run"
        kept = self.value >= self.limit if self.name in AT_LEAST else self.value <= self.limit
        return "passed" if kept else "FAILED"

    @property
    def finite(self) -> float | None:
        """The value for JSON; None if it is not finite, such as the hysteresis of a loop that is not closed."""
        return self.value if self.value is not None and isfinite(self.value) else None

    @property
    def words(self) -> str:
        """The comparison in words."""
        side = "at least" if self.name in AT_LEAST else "at most"
        measured = "was not measured" if self.value is None else f"is {self.value:.4g}"
        return f"{self.name} {measured}, must be {side} {self.limit:.4g}"


@dataclass(frozen=True)
class SequenceVerdict:
    """Every limit of every step with its value, and the end of the session."""

    sequence: TestSequence
    results: list[LimitResult]
    durations_s: dict[str, float]
    outcome: SessionOutcome

    @property
    def passed(self) -> bool:
        """Whether every limit is kept, and the session ended without a fault or a stop."""
        return all(item.result == "passed" for item in self.results) and not self.interruption

    @property
    def interruption(self) -> str:
        """Cause of an early end of the session; empty: it reached its end."""
        if self.outcome.fault:
            return f"FAULT: {self.outcome.fault}"
        return "stopped by the user" if self.outcome.stopped else ""

    @property
    def sentence(self) -> str:
        """Verdict in a sentence."""
        counts = {result: sum(item.result == result for item in self.results) for result in ("FAILED", "not run")}
        total = f"{len(self.results)} limits of {len(self.sequence.steps)} steps"
        if self.passed:
            return f"{self.sequence.name} passed: {total} are kept"
        parts = [f"{count} of {total} {result}" for result, count in counts.items() if count]
        ended = [self.interruption] if self.interruption else []
        return f"{self.sequence.name} FAILED: {'; '.join([*parts, *ended])}"

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict for JSON."""
        return {
            "schema": "piezod.sequence_result/1",
            "name": self.sequence.name,
            "passed": self.passed,
            "words": self.sentence,
            "steps": [
                {
                    "name": step.name,
                    "duration_s": self.durations_s[step.name],
                    "limits": [
                        {"name": item.name, "limit": item.limit, "value": item.finite, "result": item.result.lower()}
                        for item in self.results
                        if item.step == step.name
                    ],
                }
                for step in self.sequence.steps
            ],
            "fault": self.outcome.fault,
            "stopped": self.outcome.stopped,
        }


def evaluate_sequence(sequence: TestSequence, runs: Sequence[StepRun], outcome: SessionOutcome) -> SequenceVerdict:
    """Compare each step with its limits.

    Parameters
    ----------
    runs
        Runs of the first steps or of all, in their order. An incomplete or missing one has no values.
    """
    results, durations_s = [], {}
    for step, run in zip_longest(sequence.steps, runs):
        values = measured_values(step, run) if run is not None and run.complete else {}
        results += [LimitResult(step.name, name, limit, values.get(name)) for name, limit in step.limits.given.items()]
        is_empty = run is None or not run.recording.time_s.size
        durations_s[step.name] = 0.0 if is_empty else float(run.recording.time_s[-1])
    return SequenceVerdict(sequence, results, durations_s, outcome)


def measured_values(step: SequenceStep, run: StepRun) -> dict[str, float]:
    """Values of a complete step, by the keys of its limits; nan for a loop that is not closed.

    Parameters
    ----------
    step, run
        Step of the sequence, and its measurements.
    """
    recording, force = run.recording, run.recording.channel("force_N")
    figures = tracking_figures(recording, loop=False)
    values = {
        "rms_error_N": figures.rms_error_N,
        "max_error_N": figures.max_error_N,
        "lowest_force_N": float(force.min()),
        "highest_force_N": float(force.max()),
        "missed_ticks": float(run.missed),
        "failed_exchanges": float(run.failed_exchanges),
    }
    if step.limits.max_hysteresis_percent is not None:
        values["max_hysteresis_percent"] = _hysteresis_percent(step, recording)
    return values


def _hysteresis_percent(step: SequenceStep, recording: Recording) -> float:
    """Max hysteresis behind the first period, if there are more; nan without a closed loop."""
    period_s = 1.0 / getattr(step.reference, "frequency_Hz", np.inf)
    steady = recording.time_s >= (period_s if recording.time_s[-1] > 1.5 * period_s else 0.0)
    try:
        return max_hysteresis_percent(recording.channel("reference_N")[steady], recording.channel("force_N")[steady])
    except ValueError:
        return float("nan")


def sequence_text(verdict: SequenceVerdict) -> str:
    """Format the verdict as text: one line for each limit, then a sentence."""
    return "\n".join([*text_table([HEADER, *_rows(verdict)]), verdict.sentence])


def junit_xml(verdict: SequenceVerdict) -> str:
    """Format the verdict as JUnit XML: one test case for each limit of each step, and one for the end of the session.

    A limit that was not measured is a failure: a reader of such files takes a skipped test for a passed one. Source of
    the form: github.com/testmoapp/junitxml.
    """
    failures = sum(item.result != "passed" for item in verdict.results) + bool(verdict.interruption)
    numbers = {
        "tests": str(len(verdict.results) + 1),
        "failures": str(failures),
        "errors": "0",
        "skipped": "0",
        "time": f"{sum(verdict.durations_s.values()):.3f}",
    }
    root = ET.Element("testsuites", {"name": verdict.sequence.name, **numbers})
    suite = ET.SubElement(root, "testsuite", {"name": verdict.sequence.name, **numbers})
    for item in verdict.results:
        about = {"classname": f"{verdict.sequence.name}.{item.step}", "name": item.name}
        case = ET.SubElement(suite, "testcase", about | {"time": f"{verdict.durations_s[item.step]:.3f}"})
        if item.result != "passed":
            ET.SubElement(case, "failure", {"message": item.words, "type": "limit"})
    end = ET.SubElement(suite, "testcase", {"classname": verdict.sequence.name, "name": "end", "time": "0.000"})
    if verdict.interruption:
        ET.SubElement(end, "failure", {"message": verdict.interruption, "type": "end"})
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def write_sequence_page(path: Path, verdict: SequenceVerdict, runs: Sequence[StepRun], step: NextStep) -> None:
    """Write the page: verdict, limits, and the force and error of each step.

    Parameters
    ----------
    runs
        Runs of the steps, in their order.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    parts: list[Part] = [table_html(HEADER, _rows(verdict)).replace("'numbers'", "'words'")]
    for number, (planned, run) in enumerate(zip(verdict.sequence.steps, runs, strict=True), 1):
        if run.recording.time_s.size:
            parts += [f"<h2>{number}. {html.escape(planned.name)}</h2>", _figures(run.recording)]
    write_page(path, "Test sequence", (f"Test sequence: {verdict.sequence.name}", verdict.sentence), parts, step)


def _figures(recording: Recording) -> list[figure]:
    time_s = decimated(recording.time_s)
    reference, force = (decimated(recording.channel(name)) for name in ("reference_N", "force_N"))
    forces = labelled_figure("Force", "time [s]", "force [N]", 240)
    forces.line(time_s, reference, color=GREY, line_width=3, legend_label="reference")
    forces.line(time_s, force, color=BLUE, legend_label="force")
    errors = labelled_figure("Force minus reference", "time [s]", "error [N]", 240, x_range=forces.x_range)
    errors.line(time_s, force - reference, color=ORANGE, legend_label="error")
    return [finish_figure(forces), finish_figure(errors)]


def _rows(verdict: SequenceVerdict) -> list[list[str]]:
    return [
        [item.step, item.name, "-" if item.value is None else _number(item.value, item.name), _limit(item), item.result]
        for item in verdict.results
    ]


def _limit(item: LimitResult) -> str:
    return f"{'>=' if item.name in AT_LEAST else '<='} {_number(item.limit, item.name)}"


def _number(value: float, name: str) -> str:
    return f"{value:.4g} {UNITS[name]}".rstrip()
