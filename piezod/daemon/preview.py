"""What it costs that a reference is not known ahead: delay and mode cannot be met, and readings come late.

The force wanted now is compared with the one wanted as long ago as the model says a reading comes late: as much of the
tracking error is owed to the missing preview, and would go if the reference were sent as a file or a waveform.
"""

from math import nan, sqrt

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.config.reference import RegisterReference, StreamReference
from piezod.control import State
from piezod.errors import ModelError
from piezod.model import ExtendedCompensator, Model

Array = NDArray[np.float64]


class MissingPreview:
    """Sums up, in memory that does not grow, how far a live reference runs away while a reading is late.

    Parameters
    ----------
    late_s
        By how much readings come late [s].
    rate_Hz
        Of the ticks.
    """

    def __init__(self, late_s: float, rate_Hz: float) -> None:
        self.late_s = late_s
        late = late_s * rate_Hz
        self._whole, self._part = int(late), late - int(late)
        self._past: Array = np.empty(0)
        self.ticks = 0
        self._squares = 0.0

    @property
    def cost_N(self) -> float:
        """Root mean square of the error that is owed to it [N]; nan before enough was followed."""
        return sqrt(self._squares / self.ticks) if self.ticks else nan

    def add(self, rows: NDArray[np.void]) -> None:
        """Take in new rows."""
        if not rows.size:
            return
        if not np.all(rows["state"] == State.RUNNING):
            rows = rows[np.flatnonzero(rows["state"] != State.RUNNING)[-1] + 1 :]
            self._past = np.empty(0)
        wanted = np.concatenate((self._past, rows["reference_N"]))
        first = self._whole + 1
        if wanted.size > first:
            ago = (1.0 - self._part) * wanted[1 : wanted.size - first + 1] + self._part * wanted[: wanted.size - first]
            self._squares += float(np.sum(np.square(wanted[first:] - ago)))
            self.ticks += wanted.size - first
        self._past = wanted[-first:]

    def as_dict(self) -> dict[str, float | None]:
        """For the run's result."""
        return {"late_s": self.late_s, "cost_rms_N": self.cost_N if self.ticks else None}

    def words(self) -> str:
        """For people."""
        cost = f", {self.cost_N:.2f} N rms of the error by the model" if self.ticks else ""
        return f"the reference is not known ahead: readings come {1e3 * self.late_s:.1f} ms after it{cost}"


def missing_preview(bench: BenchConfig, model: Model) -> MissingPreview | None:
    """What a bench's reference lacks; None where it is known ahead, or nothing comes late."""
    if bench.compensation != "inverse" or not isinstance(bench.reference, (RegisterReference, StreamReference)):
        return None
    try:
        late_s = ExtendedCompensator(model, bench.dt_s, bench.compensation_without).late_s
    except ModelError:
        return None
    return MissingPreview(late_s, bench.rate_Hz) if late_s > 0.0 else None


__all__ = ["MissingPreview", "missing_preview"]
