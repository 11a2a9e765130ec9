"""Iterative learning of a looped reference, in the daemon beside the control process.

Rows of the ring log are collected into passes of whole repeats, at least `LEAST_PASS_S` long. A pass ends shortly
before a repeat does, so that the next correction is ready when the next repeat begins. The control process takes it
over there (`control/references/repeat_correction.py`). Limits, interlocks and the model are the same with it.
"""

from collections.abc import Callable, Sequence
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.config import BenchConfig
from piezod.control.references.iterative_learning import Bounds, IterativeLearning, Learning
from piezod.control.references.repeat_correction import RepeatCorrection
from piezod.daemon.expected_rows import ExpectedRows
from piezod.model import Model, make_compensator
from piezod.runtime import threads
from piezod.session.assembly import plan_ahead, reference_table
from piezod.session.history import is_tracking
from piezod.session.learned_file import LearnedFile, most_N

LEAST_PASS_S = 1.0
"""Shortest pass [s]: a correction is computed in some 10 ms, and the rows are read ten times a second."""
READY_S = 0.3  # time before the end of a repeat at which a pass ends [s], at most a quarter of the pass
MOST_MISSING = 0.01  # part of the ticks of a pass whose reading may be missing; they are interpolated
CHANGED_V = 1e-3
"""Difference of planned and written voltage that a limit causes [V]; rounding of a float32 on the wire is smaller."""
FROZEN_SAMPLES = 3
FROZEN_ERRORS = 5.0
"""Three equal readings or more that are five rms errors from the reference are a frozen reading: it teaches nothing."""

Runner = Callable[[Callable[[], None]], None]


def in_thread(work: Callable[[], None]) -> None:
    """Run `work` in a thread of its own."""
    threads.Thread(target=work, daemon=True).start()


class LearningWatch:
    """Learns the correction of the reference of one control process.

    Parameters
    ----------
    bench, path
        Bench configuration with a section `learning`, and its file.
    correction
        Correction that the control process reads.
    log
        Called with one line when learning starts from a file, cannot write it, or stops.
    run
        Function that runs the computation of a correction, by default in a thread.

    Raises
    ------
    PiezodError
        The reference or the compensation cannot be made.
    """

    def __init__(
        self,
        bench: BenchConfig,
        path: Path,
        model: Model,
        correction: RepeatCorrection,
        log: Callable[[str], None],
        run: Runner = in_thread,
    ) -> None:
        assert bench.learning is not None
        self._log, self._run, self._correction = log, run, correction
        table = reference_table(bench, path.parent)
        plan_ahead(table, make_compensator(bench.compensation, model, bench.dt_s, bench.compensation_without))
        self._table, self._ticks = table, len(table)
        self._repeats = ceil(LEAST_PASS_S * bench.rate_Hz / self._ticks)
        pass_ticks = self._repeats * self._ticks
        self._ready_ticks = min(pass_ticks // 4, ceil(READY_S * bench.rate_Hz))
        allowed = bench.reference_range
        bounds = Bounds(most_N(bench, table), allowed.low_N, allowed.high_N)
        self._learning = IterativeLearning(table.values(), table.planned(), bench.rate_Hz, bounds)
        self._expected = ExpectedRows(model, bench.dt_s)
        self._changed_V = max(CHANGED_V, bench.limits.voltage_step_V)
        self._file = LearnedFile(bench, path, table)
        self._first_tick = self._due = -1
        self._parts: list[tuple[NDArray[np.int64], Array, NDArray[np.bool_]]] = []
        self._computing = False
        self._log_start()

    def warm_up(self) -> None:
        """Load the compiled steps."""
        self._expected.warm_up()

    def add(self, rows: NDArray[np.void]) -> None:
        """Collect new rows of the ring log; compute a correction at the end of a pass."""
        shown = self._expected
        if not shown.add(rows):
            return
        tracking = is_tracking(shown.commands, shown.readings) & np.isfinite(shown.corrected_N)
        if self._correction.first_tick != self._first_tick:
            self._first_tick, self._parts = self._correction.first_tick, []  # the first pass has nothing before it
            self._due = self._first_tick + self._repeats * self._ticks
        commands = shown.commands[tracking]
        limited = np.abs(commands["planned_V"] - commands["voltage_V"]) > self._changed_V
        error_N = shown.corrected_N[tracking] - commands["reference_N"]
        if self.errors_N:
            frozen = _is_frozen(shown.reading_N[tracking])
            limited |= frozen & (np.abs(error_N) > FROZEN_ERRORS * self.errors_N[-1])
        self._parts.append((commands["tick"] - self._first_tick, shown.corrected_N[tracking], limited))
        if shown.commands["tick"][-1] >= self._due:
            self._end_pass()

    @property
    def errors_N(self) -> Sequence[float]:
        """Root mean square tracking errors of the last passes [N]."""
        return self._learning.errors_N

    @property
    def passes(self) -> int:
        """Number of passes so far."""
        return self._learning.repeats

    def as_dict(self) -> dict[str, object]:
        """State of the learning, for `piezod status`."""
        known = self.passes > 0
        return {
            "state": self._learning.state.value,
            "passes": self.passes,
            "first_N": self._learning.first_N if known else None,
            "rms_N": self.errors_N[-1] if known else None,
            "file": str(self._file.path),
            "problem": self._file.problem,
        }

    def _next_due(self) -> int:
        """Tick at which the next pass ends; it shares a few ticks with the first one."""
        repeats = (self._due - self._first_tick + self._ready_ticks) // self._ticks + self._repeats
        return self._first_tick + repeats * self._ticks - self._ready_ticks

    def _log_start(self) -> None:
        """Log whether the control process, which has read the file too, starts from an earlier correction."""
        if self._file.read() is not None:
            self._log(f"learning: starts from {self._file.path}")
        elif self._file.problem:
            self._log(f"learning: starts anew: {self._file.problem}")

    def _end_pass(self) -> None:
        """Join the rows of the pass that is over, and compute its correction unless one is still on its way."""
        end = self._due - self._first_tick
        pass_ticks = self._repeats * self._ticks
        tick, force_N, limited = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        inside = (tick >= end - pass_ticks) & (tick < end)
        kept = tick >= end - self._ready_ticks
        self._parts = [(tick[kept], force_N[kept], limited[kept])]
        self._due = self._next_due()
        if self._computing or self._correction.waiting or inside.sum() < (1.0 - MOST_MISSING) * pass_ticks:
            return
        tick, force_N, limited = tick[inside], force_N[inside], limited[inside]
        repeat, k = tick // self._ticks, tick % self._ticks
        used_N = self._correction.used(repeat, k)
        self._computing = True
        self._run(lambda: self._compute(k, force_N, used_N, limited))

    def _compute(self, k: NDArray[np.int64], force_N: Array, used_N: Array, limited: NDArray[np.bool_]) -> None:
        """Compute a correction and offer it; runs in a thread."""
        try:
            force, used, cut = (self._mean(k, values) for values in (force_N, used_N, limited.astype(float)))
            wanted = self._learning.add(force, used, cut > 0.0)
            if wanted is not None:
                self._correction.offer(wanted)
                self._file.write(wanted)
            if self._learning.state is Learning.STOPPED and wanted is not None:
                self._log(
                    f"learning: stopped: the error has grown again and again, to {self._learning.errors_N[-1]:.3g} N; "
                    "the best correction stays; see piezod diagnose"
                )
        finally:
            self._computing = False

    def _mean(self, k: NDArray[np.int64], values: Array) -> Array:
        """Mean of every tick of a repeat, shape (ticks,); a tick without a value is interpolated."""
        count = np.bincount(k, minlength=self._ticks)
        total = np.bincount(k, weights=values, minlength=self._ticks)
        known = np.flatnonzero(count)
        return np.interp(np.arange(self._ticks), known, total[known] / count[known], period=self._ticks)


def _is_frozen(reading_N: Array) -> NDArray[np.bool_]:
    """Mask of readings in a run of at least `FROZEN_SAMPLES` equal ones, shape (N,)."""
    if not reading_N.size:
        return np.zeros(0, dtype=bool)
    run = np.cumsum(np.diff(reading_N, prepend=np.nan) != 0.0)
    frozen: NDArray[np.bool_] = np.bincount(run)[run] >= FROZEN_SAMPLES
    return frozen
