"""Whether the bench still behaves like its model: prediction against measurement, beside the control process.

The rows of the ring log are run through `ExpectedReading`; a window's difference is summed up while a reference is
followed. Two windows in a row beyond the limit are a drift: it is said once, shown in status and metrics, and the
stretch since the last arming is kept as a recording for `piezod diagnose --from-bench`. Memory is bounded by
`drift.keep_s`, and no tick knows of any of it.
"""

import threading
from collections.abc import Callable
from math import isfinite, nan, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig, load_bench, model_path
from piezod.control import State
from piezod.errors import CheckFailedError, ConfigurationError, PiezodError
from piezod.model import Model
from piezod.model.expected import ExpectedReading
from piezod.recording import HELD_ONE_SAMPLE, Recording, write_csv
from piezod.session.history import GOOD

Array = NDArray[np.float64]

TIMES_OWN_ERROR = 3.0
OF_RANGE = 0.01  # the limit where a model does not know its own error
WINDOWS = 2  # in a row
LONGEST_GAP_S = 5.0  # of ticks that were missed; beyond it the memory is not followed


class DriftWatch:
    """Follows one control process after the other.

    Parameters
    ----------
    bench, model
        What was loaded.
    say
        Told when the bench has left its model.
    """

    def __init__(self, bench: BenchConfig, model: Model, say: Callable[[str], None]) -> None:
        assert bench.drift is not None
        self._bench, self._say, self._name = bench, say, model.name
        self._expected = ExpectedReading(model, bench.dt_s)
        own_N = model.provenance.fit.rms_held_out
        self.limit_N = bench.drift.beyond_N or (
            TIMES_OWN_ERROR * own_N if own_N else OF_RANGE * (model.output.high - model.output.low)
        )
        self._window = round(bench.drift.window_s * bench.rate_Hz)
        self._most = round(bench.drift.keep_s * bench.rate_Hz)
        self.path = stretch_path(bench)
        self._last: NDArray[np.void] | None = None
        self._kept: list[NDArray[np.void]] = []
        self._rows_kept = 0
        self._whole, self._state = False, int(State.DISARMED)
        self._count = self._beyond = self.windows = 0
        self._sum = self._squares = 0.0
        self._first_N: float | None = None
        self.corrected_N = self.rms_N = self.offset_N = nan
        self.drifted = False
        self._writing: threading.Thread | None = None
        self.problem = ""

    def warm_up(self) -> None:
        """Have the compiled steps loaded."""
        self._expected.run(np.zeros(1), np.full(1, nan))
        self._expected.reset()

    def begin(self) -> None:
        """A new control process: its bench is at rest."""
        self._last = None
        self._expected.reset()

    def add(self, rows: NDArray[np.void]) -> None:
        """Take in new rows; a reading answers the command one row before it."""
        if not rows.size:
            return
        joined = rows if self._last is None else np.concatenate((self._last, rows))
        self._last = rows[-1:].copy()
        self._keep(rows)
        if joined.size < 2:
            return
        commands, answers = joined[:-1], joined[1:]
        steps = np.diff(joined["tick"])
        if steps.max() > LONGEST_GAP_S * self._bench.rate_Hz:
            self.begin()
            return
        good = answers["result"] == GOOD
        last = np.cumsum(steps) - 1
        voltage_V = np.repeat(commands["voltage_V"], steps)
        reading_N = np.full(voltage_V.size, nan)
        reading_N[last] = np.where(good, answers["force_N"], nan)
        expected, corrected = self._expected.run(voltage_V, reading_N, float(answers["temperature_C"][-1]))
        self.corrected_N = float(corrected[-1])
        followed = good & (commands["state"] == State.RUNNING) & (answers["state"] == State.RUNNING)
        self._judge((reading_N[last] - expected[last])[followed])

    def corrected(self) -> float | None:
        """The force behind the last reading [N]; None before the first."""
        return self.corrected_N if isfinite(self.corrected_N) else None

    def as_dict(self) -> dict[str, object]:
        """For `status`."""
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
        """Keep what there is of a drift, and let a file be finished."""
        if self.drifted and not self._whole:
            self._write()
        if self._writing is not None:
            self._writing.join()

    def _judge(self, missing_N: Array) -> None:
        """Sum up a difference; at a window's end compare it."""
        while missing_N.size:
            part = missing_N[: self._window - self._count]
            missing_N = missing_N[part.size :]
            self._count += part.size
            self._sum += float(part.sum())
            self._squares += float(np.square(part).sum())
            if self._count >= self._window:
                self._close_window()

    def _close_window(self) -> None:
        mean_N = self._sum / self._count
        self.rms_N = sqrt(max(self._squares / self._count - mean_N**2, 0.0))
        self._first_N = mean_N if self._first_N is None else self._first_N
        self.offset_N = mean_N - self._first_N
        self._count, self._sum, self._squares = 0, 0.0, 0.0
        self.windows += 1
        beyond = max(self.rms_N, abs(self.offset_N)) > self.limit_N
        self._beyond = self._beyond + 1 if beyond else 0
        if self._beyond >= WINDOWS and not self.drifted:
            self.drifted = True
            self._say(
                f"drift: force {self.rms_N:.2f} N rms, {self.offset_N:+.2f} N in the mean from what model "
                f"'{self._name}' expects, limit {self.limit_N:.2f} N; see piezod diagnose --from-bench"
            )
            self._write()

    def _keep(self, rows: NDArray[np.void]) -> None:
        """Rows since the last arming, as many as are kept; what is older is given up."""
        before, self._state = np.append(self._state, rows["state"][:-1]), int(rows["state"][-1])
        if self._whole:
            return
        armed = np.flatnonzero((rows["state"] == State.ARMING) & (before == State.DISARMED))
        if armed.size and not self.drifted:
            self._kept, self._rows_kept = [], 0
            rows = rows[max(0, int(armed[-1]) - 1) :]
        if armed.size or self._kept:
            self._kept.append(rows)
            self._rows_kept += int(rows.size)
        if self.drifted and (self._rows_kept > self._most or self._state == State.DISARMED):
            self._write()
            self._whole = True
        elif self._state == State.DISARMED:
            self._kept, self._rows_kept = [], 0
        while self._rows_kept > self._most and len(self._kept) > 1:
            self._rows_kept -= int(self._kept.pop(0).size)

    def _write(self) -> None:
        """Write the stretch in a thread of its own, after the one before."""
        if self._writing is not None:
            self._writing.join()
        rows = np.concatenate(self._kept)
        self._writing = threading.Thread(target=self._write_rows, args=(rows,), daemon=True)
        self._writing.start()

    def _write_rows(self, rows: NDArray[np.void]) -> None:
        answers, voltage_V = rows[1:], rows["voltage_V"][:-1]
        good = answers["result"] == GOOD
        columns = {"voltage_V": voltage_V[good], "force_N": answers["force_N"][good]}
        if np.isfinite(answers["temperature_C"][good]).all():
            columns["temperature_C"] = answers["temperature_C"][good]
        time_s = answers["tick"][good] * self._bench.dt_s
        metadata = {"bench": self._bench.name, "model": self._name, "kept": "left its model"} | HELD_ONE_SAMPLE.metadata
        try:
            write_csv(Recording(time_s - time_s[0], columns, metadata=metadata), self.path)
        except (PiezodError, OSError) as error:
            self.problem = str(error)


def stretch_path(bench: BenchConfig) -> Path:
    """Where the stretch of a bench that left its model is kept: beside the ring log unless named."""
    if bench.drift is not None and bench.drift.file is not None:
        return Path(bench.drift.file.replace("{name}", bench.name))
    return bench.ring_log_path.with_name(bench.ring_log_path.name + ".drift.csv")


def kept_stretch(path: Path) -> tuple[Path, Path]:
    """The stretch that was kept of a bench, and the model that it left.

    Parameters
    ----------
    path
        Bench configuration.

    Raises
    ------
    ConfigurationError
        The bench watches no drift.
    CheckFailedError
        Nothing was kept.
    """
    bench = load_bench(path)
    if bench.drift is None:
        raise ConfigurationError(f"{path}: drift is null, must be a section: nothing is watched, so nothing is kept")
    kept = stretch_path(bench)
    if not kept.exists():
        raise CheckFailedError(
            f"{kept}: not there: this bench has not left its model; see piezod status, or name a recording"
        )
    return kept, model_path(bench, path)


__all__ = ["DriftWatch", "kept_stretch", "stretch_path"]
