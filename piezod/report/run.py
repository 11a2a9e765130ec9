"""Figures and page of a run, computed from its recording. The run may have been interrupted."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.models import ColumnDataSource
from bokeh.plotting import figure
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.control import CAUSE_TEXT, Cause, State
from piezod.errors import RecordingError
from piezod.recording import Recording
from piezod.report.figures.durations import EDGES_us, bars, histogram
from piezod.report.figures.layout import finish_figure, labelled_figure
from piezod.report.figures.thinning import broken_at_gaps, envelope, envelope_times, extremes
from piezod.report.next_step import NextStep
from piezod.report.next_step.of_benches import after_report
from piezod.report.page import Part, axis_label, table_html, write_page
from piezod.report.run_facts import drifted_at, fact_rows, share_text
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED

POINTS = 4000  # of a drawn curve
MOST_TRANSITIONS = 200  # of the table


@dataclass(frozen=True)
class Transition:
    """A change of state or of its cause."""

    time_s: float
    state: State
    cause: Cause


@dataclass(frozen=True)
class RunFigures:
    """Figures of a run; None where the recording lacks the columns.

    Parameters
    ----------
    duration_s, samples
        Length of the recording [s], [samples].
    running_s
        Time in which the force followed the reference [s].
    rms_error_N, max_error_N
        Force minus reference during that time [N].
    voltage_V, force_N
        Smallest and largest value [V], [N].
    ended
        State and cause at the last tick.
    transitions
        Changes of state or cause, in order of time.
    """

    duration_s: float
    samples: int
    missed: int | None
    running_s: float | None
    rms_error_N: float | None
    max_error_N: float | None
    voltage_V: tuple[float, float] | None
    force_N: tuple[float, float] | None
    ended: Transition | None
    transitions: list[Transition]

    @property
    def sentence(self) -> str:
        """Verdict in a sentence."""
        facts = [f"{self.duration_s:.1f} s"]
        if self.running_s:
            facts.append(f"{self.running_s:.1f} s in RUNNING")
        if self.rms_error_N is not None and self.max_error_N is not None:
            facts.append(f"rms error {self.rms_error_N:.3g} N, largest {self.max_error_N:.3g} N")
        if self.missed:
            facts.append(f"{self.missed} ticks missed ({share_text(self.missed, self.samples + self.missed)})")
        return f"{self._end()}: {', '.join(facts)}"

    def _end(self) -> str:
        if self.ended is None:
            return "recorded"
        if self.ended.state is State.FAULT:
            return f"ended in FAULT, {CAUSE_TEXT[self.ended.cause]}"
        if self.ended.state is State.DISARMED:
            return "ended in DISARMED"
        return f"interrupted in {self.ended.state.name}"

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for JSON."""
        return {
            "schema": "piezod.run_report/1",
            "words": self.sentence,
            **{name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("ended", "transitions")},
            "transitions": [
                {"time_s": change.time_s, "state": change.state.name, "cause": CAUSE_TEXT[change.cause]}
                for change in self.transitions
            ],
        }


def run_figures(recording: Recording) -> RunFigures:
    """Compute the figures of a run from the columns that its recording has.

    Parameters
    ----------
    recording
        Recording, best with `state`, `cause`, `tick`, `reference_N`, `force_N` and `voltage_V`.

    Raises
    ------
    RecordingError
        The recording has no sample.
    """
    if not recording.time_s.size:
        raise RecordingError(f"{recording.source}: has no sample to report")
    transitions = _transitions(recording)
    running, error = _followed(recording), _error(recording)
    known = None if error is None else error[running & np.isfinite(error)]
    tick = recording.channels.get("tick")
    return RunFigures(
        duration_s=float(recording.time_s[-1] - recording.time_s[0]),
        samples=int(recording.time_s.size),
        missed=None if tick is None else int(tick[-1] - tick[0]) + 1 - tick.size,
        running_s=float(np.count_nonzero(running) * recording.dt_s) if recording.time_s.size > 1 else None,
        rms_error_N=float(np.sqrt(np.mean(known**2))) if known is not None and known.size else None,
        max_error_N=float(np.abs(known).max()) if known is not None and known.size else None,
        voltage_V=_span(recording.channels.get("voltage_V")),
        force_N=_span(recording.channels.get("force_N")),
        ended=transitions[-1] if transitions else None,
        transitions=transitions,
    )


def write_run_page(path: Path, recording: Recording, figures: RunFigures, step: NextStep | None = None) -> None:
    """Write the page: verdict, facts, transitions of state, curves over time, loops, and timing.

    Parameters
    ----------
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    parts: list[Part] = []
    if facts := fact_rows(recording, _error(recording)):
        parts.append(table_html(["", "of this run"], facts).replace("'numbers'", "'words'"))
    if figures.transitions:
        shown = figures.transitions[:MOST_TRANSITIONS]
        rows = [[f"{c.time_s:.3f}", c.state.name.replace("_", " "), CAUSE_TEXT[c.cause]] for c in shown]
        more = f"<p class='dim'>and {len(figures.transitions) - len(shown)} more</p>"
        table = table_html(["time [s]", "state", "cause"], rows).replace("'numbers'", "'words'")
        parts.append(f"<h2>Changes of state</h2>{table}{more if len(figures.transitions) > len(shown) else ''}")
    parts.append("<h2>Over time</h2>")
    parts.extend([plot] for plot in _over_time(recording))
    for title, row in (("Loops", [*_loops(recording)]), ("Timing", [*_durations(recording)])):
        if row:
            parts.extend((f"<h2>{title}</h2>", row))
    parts.append(
        "<p class='dim'>Long curves are thinned: each segment is drawn by its smallest and its largest value.</p>"
    )
    write_page(path, "Run", (f"Run: {Path(recording.source).name}", figures.sentence), parts, step)


def next_after(recording: Recording, figures: RunFigures) -> NextStep:
    """Next step after a run."""
    ended = figures.ended
    fault = CAUSE_TEXT[ended.cause] if ended is not None and ended.state is State.FAULT else ""
    missed = (figures.missed or 0) / max(1, (figures.missed or 0) + figures.samples)
    return after_report(Path(recording.source), fault=fault, drifted=bool(drifted_at(recording)), missed=missed)


def _transitions(recording: Recording) -> list[Transition]:
    state, cause = recording.channels.get("state"), recording.channels.get("cause")
    if state is None or cause is None:
        return []
    changed = np.flatnonzero((np.diff(state) != 0) | (np.diff(cause) != 0)) + 1
    return [
        Transition(time_s, State(int(code)), Cause(int(why)))
        for time_s, code, why in zip(
            *(values[[0, *changed]].tolist() for values in (recording.time_s, state, cause)), strict=True
        )
    ]


def _followed(recording: Recording) -> NDArray[np.bool_]:
    """Mask of the samples at which the force followed the reference; all samples if no state is recorded."""
    state = recording.channels.get("state")
    if state is None:
        return np.ones(recording.time_s.size, dtype=np.bool_)
    running = state == State.RUNNING
    running_before = np.concatenate(([False], running[:-1]))  # a force answers the command of the tick before
    followed: NDArray[np.bool_] = running & running_before
    return followed


def _error(recording: Recording) -> Array | None:
    force, reference = recording.channels.get("force_N"), recording.channels.get("reference_N")
    if force is None or reference is None:
        return None
    error: Array = np.where(_followed(recording), force - reference, np.nan)
    return error


def _span(values: Array | None) -> tuple[float, float] | None:
    known = None if values is None else values[np.isfinite(values)]
    return (float(known.min()), float(known.max())) if known is not None and known.size else None


def _over_time(recording: Recording) -> Iterable[figure]:
    shown_s = envelope_times(recording.time_s, POINTS)
    channels = recording.channels
    first = None
    reference = channels.get("reference_N")
    if reference is not None:
        reference = np.where(_followed(recording), reference, np.nan)
    groups = (
        ("Force", "force_N", {"reference": (reference, GREY, 3), "force": (channels.get("force_N"), BLUE, 1)}, 300),
        ("Error: force minus reference", "error_N", {"error": (_error(recording), ORANGE, 1)}, 200),
        ("Voltage", "voltage_V", {"voltage": (channels.get("voltage_V"), BLUE, 1)}, 200),
        ("Temperature", "temperature_C", {"temperature": (channels.get("temperature_C"), RED, 1)}, 160),
    )
    for title, column, curves, height in groups:
        drawn = [
            (name, values, colour, width)
            for name, (values, colour, width) in curves.items()
            if values is not None and np.isfinite(values).any()
        ]
        if not drawn:
            continue
        plot = labelled_figure(title, "time [s]", axis_label(column), height)
        if first is not None:
            plot.x_range = first.x_range
        for name, values, colour, width in drawn:
            curve = broken_at_gaps(shown_s, envelope(values, POINTS))
            plot.line(*curve, color=colour, line_width=width, legend_label=name)
        first = first or plot
        yield finish_figure(plot)


def _loops(recording: Recording) -> Iterable[figure]:
    voltage, force = recording.channels.get("voltage_V"), recording.channels.get("force_N")
    if voltage is None or force is None or not np.isfinite(force).any():
        return
    chosen = extremes(force, POINTS)
    plot = labelled_figure("Force over voltage", "voltage [V]", "force [N]", 320)
    plot.line(voltage[chosen], force[chosen], color=BLUE, legend_label="measured")
    yield finish_figure(plot)
    error = _error(recording)
    if error is None or not np.isfinite(error).any():
        return
    reference, chosen = recording.channel("reference_N"), extremes(error, POINTS)
    plot = labelled_figure("Error over reference", "reference [N]", "error [N]", 320)
    plot.line(reference[chosen], error[chosen], color=ORANGE, legend_label="error")
    yield finish_figure(plot)


def _durations(recording: Recording) -> Iterable[figure]:
    for title, column, colour in (
        ("How late the ticks were", "lateness_ns", BLUE),
        ("How long an exchange took", "exchange_ns", GREEN),
    ):
        values = recording.channels.get(column)
        if values is None:
            continue
        counts, _ = np.histogram(np.clip(values * 1e-3, EDGES_us[0], EDGES_us[-1]), EDGES_us)
        period_s = recording.dt_s if recording.time_s.size > 1 else None
        yield finish_figure(histogram(title, ColumnDataSource(bars(counts)), period_s, colour, height=320))
