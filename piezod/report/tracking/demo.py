"""What the demo says: a live line, one table, one page, one verdict."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from piezod.recording import Recording
from piezod.report.page import table_html
from piezod.report.tracking.page import LABELS, TrackingFigures, tracking_figures, write_tracking_page

QUARTER = 0.25  # compensated hysteresis may be at most this part of the uncompensated
STATES = ("DISARMED", "ARMING", "RUNNING", "HOLD", "RAMP_DOWN", "FAULT")
HEADER = ["reference", "compensation", "rms error [N]", "[%]", "max error [N]", "[%]", "max hysteresis [%]"]


Rows = NDArray[np.void]


class Timing(Protocol):
    """Percentiles in microseconds."""

    @property
    def lateness_us(self) -> dict[str, float]:
        """Of the wake-ups."""
        ...

    @property
    def completion_us(self) -> dict[str, float]:
        """From the deadline to the committed state."""
        ...


class SessionOutcome(Protocol):
    """What the control process counted."""

    ticks: int
    missed: int
    failed_exchanges: int
    results: dict[str, int]
    fault: str
    stopped: bool
    warnings: list[str]
    resident_kib: int


@dataclass(frozen=True)
class DemoVerdict:
    """The figures of the demo and whether it passed."""

    figures: dict[tuple[str, str], TrackingFigures]
    timing: Timing
    outcome: SessionOutcome
    hidden: "HiddenVerdict | None" = None

    @property
    def hysteresis_ratio(self) -> float:
        """Compensated over uncompensated max hysteresis on the triangle; nan when one is missing."""
        with_inverse = self.figures.get(("triangle", "inverse"))
        with_gain = self.figures.get(("triangle", "gain"))
        if with_inverse is None or with_gain is None or not with_gain.max_hysteresis_percent:
            return float("nan")
        return (with_inverse.max_hysteresis_percent or 0.0) / with_gain.max_hysteresis_percent

    @property
    def passed(self) -> bool:
        """At most a quarter of the hysteresis is left, and no exchange failed."""
        clean = not self.outcome.failed_exchanges and not self.outcome.fault and not self.outcome.stopped
        return clean and self.hysteresis_ratio <= QUARTER and (self.hidden is None or self.hidden.passed)

    @property
    def words(self) -> str:
        """The verdict in a sentence."""
        if self.outcome.stopped:
            return "stopped: ramped down before the end"
        if self.outcome.fault:
            return f"FAULT: {self.outcome.fault}"
        if self.outcome.failed_exchanges:
            return f"{self.outcome.failed_exchanges} exchanges failed: {self.outcome.results}"
        gain = self.figures["triangle", "gain"].max_hysteresis_percent
        inverse = self.figures["triangle", "inverse"].max_hysteresis_percent
        return (
            f"hysteresis {gain:.2f} % -> {inverse:.2f} % of range, {self.hysteresis_ratio:.0%} of it left "
            f"({'at most' if self.passed else 'NOT below'} {QUARTER:.0%})"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "schema": "piezod.demo/1",
            "hidden": None if self.hidden is None else self.hidden.as_dict(),
            "passed": self.passed,
            "words": self.words,
            "figures": [
                {"reference": key[0], "compensation": key[1], **one.as_dict()} for key, one in self.figures.items()
            ],
            "ticks": self.outcome.ticks,
            "missed": self.outcome.missed,
            "failed_exchanges": self.outcome.failed_exchanges,
            "lateness_us": self.timing.lateness_us,
            "completion_us": self.timing.completion_us,
            "resident_kib": self.outcome.resident_kib,
            "warnings": self.outcome.warnings,
        }


@dataclass(frozen=True)
class HiddenVerdict:
    """The bench that hid something: what the diagnosis says, and what driving by it is worth.

    Parameters
    ----------
    sentence
        Of the diagnosis.
    figures
        By compensation: gain, inverse, extended.
    noise_N
        Of the reading, by the diagnosis [N].
    """

    sentence: str
    figures: dict[str, TrackingFigures]
    noise_N: float

    @property
    def passed(self) -> bool:
        """What was found brings the error at least down to half."""
        return self.figures["extended"].rms_error_N <= 0.5 * self.figures["inverse"].rms_error_N

    @property
    def words(self) -> str:
        """In a sentence."""
        static, extended = self.figures["inverse"], self.figures["extended"]
        return (
            f"hidden effects: error {static.rms_error_percent:.2f} % -> {extended.rms_error_percent:.2f} % rms "
            f"({'at most' if self.passed else 'NOT below'} 50% of it); the reading's noise alone is "
            f"{100.0 * self.noise_N / extended.range_N:.2f} %"
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        figures = [{"compensation": name, **one.as_dict()} for name, one in self.figures.items()]
        return {"diagnosis": self.sentence, "noise_N": self.noise_N, "figures": figures, "virtual_time": True}


def judge_hidden(recordings: dict[tuple[str, str], Recording], sentence: str, noise_N: float) -> HiddenVerdict:
    """Figures of the bench that hid something."""
    figures = {compensation: tracking_figures(one, loop=False) for (_, compensation), one in recordings.items()}
    return HiddenVerdict(sentence, figures, noise_N)


def print_hidden(hidden: HiddenVerdict) -> None:
    """The four rows and the sentence."""
    print("a bench that hides creep, lag and delay (emulated in virtual time, as fast as this machine goes):")
    print(f"  diagnosis: {hidden.sentence}")
    print(f"  {'compensation':<20} {'rms error [N]':>13} {'[%]':>6} {'max error [N]':>14} {'[%]':>6}")
    for name, one in hidden.figures.items():
        print(
            f"  {LABELS[name]:<20} {one.rms_error_N:>13.2f} {one.rms_error_percent:>6.2f} {one.max_error_N:>14.2f} "
            f"{one.max_error_percent:>6.2f}"
        )
    share = 100.0 * hidden.noise_N / hidden.figures["extended"].range_N
    print(f"  {'noise of the reading':<20} {hidden.noise_N:>13.2f} {share:>6.2f} {'-':>14} {'-':>6}")
    print(hidden.words)


def judge(recordings: dict[tuple[str, str], Recording], timing: Timing, outcome: SessionOutcome) -> DemoVerdict:
    """Figures of every reference that was followed."""
    figures = {
        key: tracking_figures(recording, loop=key[0] == "triangle")
        for key, recording in recordings.items()
        if recording.time_s.size > 1
    }
    return DemoVerdict(figures, timing, outcome)


@contextlib.contextmanager
def live_line(names: list[str]) -> Iterator[Callable[[Rows], None]]:
    """Yield a function that shows the newest row: one line overwritten on a terminal, one a second elsewhere."""
    terminal = sys.stdout.isatty()
    last_ns = 0

    def show(rows: Rows) -> None:
        nonlocal last_ns
        if not len(rows) or (not terminal and int(rows["time_ns"][-1]) - last_ns < 1_000_000_000):
            return
        row = rows[-1]
        last_ns = int(row["time_ns"])
        error = row["force_N"] - row["reference_N"] if row["state"] == 2 else float("nan")
        number = int(row["segment"])
        text = (
            f"{STATES[row['state']]:9} {names[number] if 0 <= number < len(names) else '':20} "
            f"reference {row['reference_N']:7.2f} N  force {row['force_N']:7.2f} N  error {error:+6.2f} N  "
            f"late {rows['lateness_ns'].max() / 1000:5.0f} us"
        )
        print(f"\r{text}\x1b[K" if terminal else text, end="" if terminal else "\n", flush=True)

    yield show
    if terminal:
        print("\r\x1b[K", end="", flush=True)


def _rows(verdict: DemoVerdict) -> list[list[str]]:
    return [
        [
            key[0],
            LABELS[key[1]],
            f"{one.rms_error_N:.2f}",
            f"{one.rms_error_percent:.2f}",
            f"{one.max_error_N:.2f}",
            f"{one.max_error_percent:.2f}",
            "-" if one.max_hysteresis_percent is None else f"{one.max_hysteresis_percent:.2f}",
        ]
        for key, one in verdict.figures.items()
    ]


def _timing_words(verdict: DemoVerdict) -> str:
    late = verdict.timing.lateness_us
    return (
        f"{verdict.outcome.ticks} ticks, {verdict.outcome.missed} missed, {verdict.outcome.failed_exchanges} failed "
        f"exchanges; lateness p50 {late['p50']:.0f} us, p99 {late['p99']:.0f} us, p99.9 {late['p99.9']:.0f} us"
    )


def print_table(verdict: DemoVerdict) -> None:
    """The table, the timing and the verdict, as text."""
    rows = _rows(verdict)
    widths = [max(len(line[k]) for line in [HEADER, *rows]) for k in range(len(HEADER))]
    for line in [HEADER, *rows]:
        cells = [
            cell.ljust(w) if k < 2 else cell.rjust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True))
        ]
        print("  ".join(cells))
    print(_timing_words(verdict))
    for warning in verdict.outcome.warnings:
        print(f"warning: {warning}")
    print(verdict.words)


def write_demo_page(path: Path, verdict: DemoVerdict, recordings: dict[tuple[str, str], Recording]) -> None:
    """The page of the demo."""
    shown = {key: recording for key, recording in recordings.items() if recording.time_s.size > 1}
    table = table_html(HEADER, _rows(verdict)) + f"<p>{_timing_words(verdict)}</p>"
    write_tracking_page(path, "A force follows its reference", verdict.words, shown, table)
