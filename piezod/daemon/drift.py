"""Comparison of a running bench with its model, in the daemon, beside the control process.

`ExpectedReading` predicts the reading of every tick from the written voltages. While a reference is followed, the
difference of reading and prediction is summed up over windows of `drift.window_s`. The bench has drifted when two
windows in a row exceed the limit. The daemon then logs it once and shows it in status and metrics. The ticks since
the last arming are written to a file for `piezod diagnose --from-bench`. `drift.keep_s` bounds the memory.
"""

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from math import isfinite, nan, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, load_bench, model_path
from piezod.control import State
from piezod.daemon.expected_rows import ExpectedRows
from piezod.errors import CheckFailedError, ConfigurationError
from piezod.model import Model
from piezod.recording import HELD_ONE_SAMPLE, Recording
from piezod.recording.ticks import GOOD, pair_rows
from piezod.session.history import is_tracking
from piezod.session.kept_csv import KeptCsv

Array = NDArray[np.float64]

LIMIT_IN_MODEL_ERRORS = 3.0
"""Default limit, as a multiple of the held-out rms error of the model."""
LIMIT_IN_RANGES = 0.01
"""Default limit as a part of the force range, for a model without a held-out error."""
WINDOWS = 2
"""Number of windows in a row above the limit that count as a drift."""


class DriftWatch:
    """Comparison of one control process after the other with the model.

    Parameters
    ----------
    bench
        Bench configuration with a section `drift`.
    model
        Model of the bench.
    log
        Called with one line when the bench has drifted.

    Attributes
    ----------
    limit_N
        Limit for rms and offset [N].
    path
        File for the ticks of a bench that has drifted.
    windows
        Number of complete windows.
    rms_N
        Standard deviation of the difference in the last window [N]; nan before the first.
    offset_N
        Mean difference of the last window relative to the first window [N]; nan before the first.
    corrected_N
        Force behind the last reading, corrected for the load cell [N]; nan before the first.
    drifted
        Whether the bench has drifted.
    problem
        Why the file could not be written; empty without a failure.
    """

    def __init__(self, bench: BenchConfig, model: Model, log: Callable[[str], None]) -> None:
        assert bench.drift is not None
        self._bench, self._log, self._name = bench, log, model.name
        self._expected = ExpectedRows(model, bench.dt_s)
        own_N = model.provenance.fit.rms_held_out
        self.limit_N = bench.drift.beyond_N or (
            LIMIT_IN_MODEL_ERRORS * own_N if own_N else LIMIT_IN_RANGES * (model.output.high - model.output.low)
        )
        self._window_ticks = round(bench.drift.window_s * bench.rate_Hz)
        self._max_rows = round(bench.drift.keep_s * bench.rate_Hz)
        self.path = bench.drift_path
        self._armed_rows: list[NDArray[np.void]] = []
        self._row_count = 0
        self._complete, self._state = False, int(State.DISARMED)
        self._count = self._above_limit = self.windows = 0
        self._sum = self._sum_of_squares = 0.0
        self._first_N: float | None = None
        self.corrected_N = self.rms_N = self.offset_N = nan
        self.drifted = False
        self._writing: threading.Thread | None = None
        self.problem = ""

    def warm_up(self) -> None:
        """Load the compiled steps."""
        self._expected.warm_up()

    def begin(self) -> None:
        """Begin with a new control process, whose bench is at rest."""
        self._expected.begin()

    def add(self, rows: NDArray[np.void]) -> None:
        """Compare new rows of the ring log."""
        if not rows.size:
            return
        self._collect(rows)
        shown = self._expected
        if shown.add(rows):
            self.corrected_N = float(shown.corrected_N[-1])
            tracking = is_tracking(shown.commands, shown.readings)
            self._add_to_windows((shown.reading_N - shown.expected_N)[tracking])

    def corrected(self) -> float | None:
        """Force behind the last reading [N]; None before the first."""
        return self.corrected_N if isfinite(self.corrected_N) else None

    def as_dict(self) -> dict[str, object]:
        """Result of the comparison, for `piezod status`."""
        return {
            "drifted": self.drifted,
            "rms_N": self.rms_N if isfinite(self.rms_N) else None,
            "offset_N": self.offset_N if isfinite(self.offset_N) else None,
            "limit_N": self.limit_N,
            "windows": self.windows,
            "kept": str(self.path) if self.drifted else None,
            "problem": self.problem,
        }

    def close(self) -> None:
        """Write the collected ticks of a bench that has drifted, and wait for the file."""
        if self.drifted and not self._complete:
            self._write()
        if self._writing is not None:
            self._writing.join()

    def _add_to_windows(self, difference_N: Array) -> None:
        """Add differences to the current window; at its end compare it with the limit."""
        while difference_N.size:
            part = difference_N[: self._window_ticks - self._count]
            difference_N = difference_N[part.size :]
            self._count += part.size
            self._sum += float(part.sum())
            self._sum_of_squares += float(np.square(part).sum())
            if self._count >= self._window_ticks:
                self._close_window()

    def _close_window(self) -> None:
        mean_N = self._sum / self._count
        self.rms_N = sqrt(max(self._sum_of_squares / self._count - mean_N**2, 0.0))
        self._first_N = mean_N if self._first_N is None else self._first_N
        self.offset_N = mean_N - self._first_N
        self._count, self._sum, self._sum_of_squares = 0, 0.0, 0.0
        self.windows += 1
        is_above = max(self.rms_N, abs(self.offset_N)) > self.limit_N
        self._above_limit = self._above_limit + 1 if is_above else 0
        if self._above_limit >= WINDOWS and not self.drifted:
            self.drifted = True
            self._log(
                f"drift: force {self.rms_N:.2f} N rms, {self.offset_N:+.2f} N in the mean from what model "
                f"'{self._name}' expects, limit {self.limit_N:.2f} N; see piezod diagnose --from-bench"
            )
            self._write()

    def _collect(self, rows: NDArray[np.void]) -> None:
        """Collect the rows since the last arming; beyond `drift.keep_s` the oldest are removed."""
        before, self._state = np.append(self._state, rows["state"][:-1]), int(rows["state"][-1])
        if self._complete:
            return
        armed = np.flatnonzero((rows["state"] == State.ARMING) & (before == State.DISARMED))
        if armed.size and not self.drifted:
            self._armed_rows, self._row_count = [], 0
            rows = rows[max(0, int(armed[-1]) - 1) :]
        if armed.size or self._armed_rows:
            self._armed_rows.append(rows)
            self._row_count += int(rows.size)
        if self.drifted and (self._row_count > self._max_rows or self._state == State.DISARMED):
            self._write()
            self._complete = True
        elif self._state == State.DISARMED:
            self._armed_rows, self._row_count = [], 0
        while self._row_count > self._max_rows and len(self._armed_rows) > 1:
            self._row_count -= int(self._armed_rows.pop(0).size)

    def _write(self) -> None:
        """Write the collected rows in a thread; a previous write is finished first."""
        if self._writing is not None:
            self._writing.join()
        rows = np.concatenate(self._armed_rows)
        self._writing = threading.Thread(target=self._write_rows, args=(rows,), daemon=True)
        self._writing.start()

    def _write_rows(self, rows: NDArray[np.void]) -> None:
        commands, readings = pair_rows(rows)
        good = readings["result"] == GOOD
        commands, readings = commands[good], readings[good]
        columns = {"voltage_V": commands["voltage_V"], "force_N": readings["force_N"]}
        if np.isfinite(readings["temperature_C"]).all():
            columns["temperature_C"] = readings["temperature_C"]
        time_s = readings["tick"] * self._bench.dt_s
        recorded = datetime.now(UTC).isoformat(timespec="seconds")
        metadata = {"bench": self._bench.name, "model": self._name, "recorded": recorded} | HELD_ONE_SAMPLE.metadata
        self.problem = drift_file(self._bench).write(Recording(time_s - time_s[0], columns, metadata))


def drift_file(bench: BenchConfig) -> KeptCsv:
    """File for the recording of a bench that has drifted: `drift.file`, or a file beside the ring log.

    Parameters
    ----------
    bench
        Bench configuration.
    """
    return KeptCsv(bench.drift_path, "drift.file", ("kept", "left its model"))


def find_drift_recording(path: Path) -> tuple[Path, Path]:
    """Find the recording of a bench that has drifted, and the model that it was compared with.

    Parameters
    ----------
    path
        Bench configuration.

    Raises
    ------
    ConfigurationError
        The configuration has no section `drift`.
    CheckFailedError
        There is no such recording.
    """
    bench = load_bench(path)
    if bench.drift is None:
        raise ConfigurationError(f"{path}: drift is null, must be a section: no drift is watched, so none is recorded")
    recording = bench.drift_path
    if not recording.exists():
        raise CheckFailedError(
            f"{recording}: not there: this bench has not left its model; see piezod status, or name a recording"
        )
    return recording, model_path(bench, path)
