"""Comparison of a running bench with its model, in the daemon, beside the control process.

`ExpectedReading` predicts the reading of every tick from the written voltages. While a reference is followed, the
difference of reading and prediction is summed up over windows of `drift.window_s`. `LawTest` compares each window with
earlier ones of the same kind of input. The bench has drifted when the evidence of a change reaches a level. Without a
change this happens once in `drift.false_alarm_days` on average. The daemon then logs it once and shows it in
status and metrics. The ticks since the last arming are written to a file for `piezod diagnose --from-bench`.
`drift.keep_s` bounds the memory.
"""

from collections.abc import Callable
from datetime import UTC, datetime
from math import isfinite, nan

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.control import State
from piezod.daemon.drift.blocks import Block, BlockSums
from piezod.daemon.drift.files import BlocksFile, drift_file
from piezod.daemon.drift.law_test import BlockResult, LawTest, Tested
from piezod.daemon.drift.reference import FIRST_STRETCH, BlockReference
from piezod.daemon.expected_rows import ExpectedRows
from piezod.daemon.newest_writer import NewestWriter
from piezod.model import Model
from piezod.recording import Recording
from piezod.recording.hold import HELD_ONE_SAMPLE
from piezod.recording.ticks import GOOD, pair_rows
from piezod.runtime import clock
from piezod.session.history import is_tracking

LIMIT_IN_MODEL_ERRORS = 3.0  # default limit, as a multiple of the held-out rms error of the model
LIMIT_IN_RANGES = 0.01  # default limit as a part of the force range, for a model without a held-out error
DAY_S = 86400.0
CLOSE_WITHIN_S = 10.0  # longest time that the end of a session waits for the disk [s]
SAVED_EVERY = 360  # windows after which the reference is written: an hour of windows of 10 s


class DriftWatch:
    """Comparison of one control process after the other with the model.

    Parameters
    ----------
    bench
        Bench configuration with a section `drift`.
    log
        Called with one line when the bench has drifted.

    Attributes
    ----------
    limit_N
        Limit of the first stretch of driving [N].
    path
        File for the ticks of a bench that has drifted.
    rms_N
        Standard deviation of the difference in the last window [N]; nan before the first.
    offset_N
        Mean difference of the last window relative to the first window [N]; nan before the first.
    corrected_N
        Force behind the last reading, corrected for the load cell [N]; nan before the first.
    drifted
        Whether the bench has drifted.
    outside
        Difference of the last window's input from the known ones; empty where it was compared.
    outside_windows
        Number of windows that were not compared.
    problem
        Why the file could not be written; empty without a failure.
    """

    def __init__(self, bench: BenchConfig, model: Model, log: Callable[[str], None]) -> None:
        assert bench.drift is not None
        self._bench, self._log, self._name = bench, log, model.name
        self._expected = ExpectedRows(model, bench.dt_s)
        own_N = model.provenance.fit.rms_held_out
        span_N = model.output.high - model.output.low
        self.limit_N = bench.drift.beyond_N or (LIMIT_IN_MODEL_ERRORS * own_N if own_N else LIMIT_IN_RANGES * span_N)
        reference = BlockReference(
            (model.input.low, model.input.high), own_N or self.limit_N / LIMIT_IN_MODEL_ERRORS, bench.drift.tolerance
        )
        self._blocks_file = BlocksFile(bench, model)
        self._blocks_file.read_into(reference)
        self._first_stretch = reference.is_first_stretch
        if bench.drift.beyond_N is not None and not self._first_stretch:
            log("drift: drift.beyond_N has no effect any more: windows are compared with earlier driving of this bench")
        self.test = LawTest(reference, self.limit_N, bench.drift.false_alarm_days * DAY_S / bench.drift.window_s)
        self._sums = BlockSums(round(bench.drift.window_s * bench.rate_Hz), bench.dt_s)
        self._max_rows = round(bench.drift.keep_s * bench.rate_Hz)
        self.path = bench.drift_path
        self._armed_rows: list[NDArray[np.void]] = []
        self._row_count = 0
        self._complete, self._state = False, int(State.DISARMED)
        self.windows = self.outside_windows = 0
        self.outside = ""
        self._first_N: float | None = None
        self.corrected_N = self.rms_N = self.offset_N = nan
        self.drifted = False
        self._writer = NewestWriter()
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
            difference_N = (shown.reading_N - shown.expected_N)[tracking]
            temperature_C = float(shown.readings["temperature_C"].mean())
            for block in self._sums.add(difference_N, shown.commands["voltage_V"][tracking], temperature_C):
                self._add_block(block)
        self._forget()  # last: an alarm of a batch that ends DISARMED still writes its rows

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
            "problem": self.problem or self._blocks_file.problem,
            "evidence": self.test.alarm.evidence,
            "alarm_at": self.test.alarm.level,
            "known_windows": self.test.reference.size,
            "first_stretch": self.test.reference.is_first_stretch,
            "outside": self.outside,
            "outside_windows": self.outside_windows,
        }

    def close(self) -> None:
        """Write the known windows, and the ticks of a bench that has drifted; wait `CLOSE_WITHIN_S` for the disk."""
        if self.windows:
            self._save_blocks()
        if self.drifted and not self._complete:
            self._write()
        if not self._writer.flush(CLOSE_WITHIN_S):
            self.problem = f"{self.path}: not written within {CLOSE_WITHIN_S:g} s; check its disk"
            self._log(f"drift: {self.problem}")

    def _add_block(self, block: Block) -> None:
        """Test a complete window; after a drift only its figures are shown."""
        self.windows += 1
        self._first_N = block.mean_N if self._first_N is None else self._first_N
        self.rms_N, self.offset_N = block.rms_N, block.mean_N - self._first_N
        if self.drifted:
            return
        tested = self.test.add(block, self.offset_N)
        if tested.alarm:
            self.drifted, self.outside = True, ""
            self._log(f"drift: {self._alarm_words(tested)}; see piezod diagnose --from-bench")
            self._write()
            return
        self._note_input(block, tested)
        reference = self.test.reference
        if self._first_stretch and not reference.is_first_stretch:
            self._first_stretch = False
            self._log(f"drift: from now on compared with driving of this bench, first with {FIRST_STRETCH} windows")
        if self.windows % SAVED_EVERY == 0:
            self._save_blocks()

    def _alarm_words(self, tested: Tested) -> str:
        found = (
            f"force {self.rms_N:.2f} N rms, {self.offset_N:+.2f} N in the mean from what model '{self._name}' expects"
        )
        if tested.usual_N is None:
            return (
                f"{found}, limit {self.limit_N:.2f} N; in the first stretch of driving, so an unknown rate can be why"
            )
        return f"{found}, {tested.usual_N:.2f} N so far with the same kind of input: the law of the bench has changed"

    def _note_input(self, block: Block, tested: Tested) -> None:
        """Note an input that is not compared; log it once for each session."""
        if tested.result is not BlockResult.OUTSIDE:
            self.outside = ""
            return
        self.outside = self.test.reference.difference_of(block)
        self.outside_windows += 1
        if self.outside_windows == 1:
            self._log(
                f"drift: another input, not compared: {self.outside}; force {tested.distance_N:.2f} N from the model"
            )

    def _save_blocks(self) -> None:
        """Write the known windows, in a thread."""
        rows = self._blocks_file.rows_of(self.test.reference)
        self._writer.write("blocks", lambda: self._blocks_file.write(rows))

    def _collect(self, rows: NDArray[np.void]) -> None:
        """Collect the rows since the last arming."""
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

    def _forget(self) -> None:
        """End the recording of a drift at rest or at `drift.keep_s`; else remove what is older than that."""
        if self._complete:
            return
        if self.drifted and (self._row_count > self._max_rows or self._state == State.DISARMED):
            self._write()
            self._complete = True
        elif self._state == State.DISARMED:
            self._armed_rows, self._row_count = [], 0
        while self._row_count > self._max_rows and len(self._armed_rows) > 1:
            self._row_count -= int(self._armed_rows.pop(0).size)

    def _write(self) -> None:
        """Write the collected rows, in a thread."""
        if self._armed_rows:
            rows = np.concatenate(self._armed_rows)
            self._writer.write("drift", lambda: self._write_rows(rows))

    def _write_rows(self, rows: NDArray[np.void]) -> None:
        commands, readings = pair_rows(rows)
        good = readings["result"] == GOOD
        commands, readings = commands[good], readings[good]
        if not readings.size:
            self.problem = f"{self.path}: no good reading since the last arming; not written"
            return
        columns = {"voltage_V": commands["voltage_V"], "force_N": readings["force_N"]}
        if np.isfinite(readings["temperature_C"]).all():
            columns["temperature_C"] = readings["temperature_C"]
        time_s = readings["tick"] * self._bench.dt_s
        recorded = datetime.fromtimestamp(clock.wall_s(), UTC).isoformat(timespec="seconds")
        metadata = {"bench": self._bench.name, "model": self._name, "recorded": recorded} | HELD_ONE_SAMPLE.metadata
        self.problem = drift_file(self._bench).write(Recording(time_s - time_s[0], columns, metadata))
