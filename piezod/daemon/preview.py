"""Tracking error that results from a live reference, whose future values are unknown to the compensator.

The compensator cannot act ahead for delay and mode, so readings follow the reference late, by a time that the model
gives. The present reference is compared with the reference of that time ago. The difference is the part of the
tracking error that a known reference (a file or a waveform) would avoid.
"""

from math import nan, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from piezod.config import BenchConfig
from piezod.config.reference import RegisterReference, StreamReference
from piezod.control import State
from piezod.errors import ModelError
from piezod.model import ExtendedCompensator, Model

if TYPE_CHECKING:
    from piezod.arrays import Array


class MissingPreview:
    """Root mean square change of a live reference during the lateness of the readings, in constant memory.

    Parameters
    ----------
    late_s
        Time by which readings follow the reference late [s].
    rate_Hz
        Tick rate [Hz].
    """

    def __init__(self, late_s: float, rate_Hz: float) -> None:
        self.late_s = late_s
        late = late_s * rate_Hz
        self._whole, self._part = int(late), late - int(late)
        self._past: Array = np.empty(0)
        self.ticks = 0
        self._sum_of_squares = 0.0

    @property
    def cost_N(self) -> float:
        """Rms error caused by the missing preview [N]; nan before enough ticks of a followed reference."""
        return sqrt(self._sum_of_squares / self.ticks) if self.ticks else nan

    def add(self, rows: NDArray[np.void]) -> None:
        """Add new rows of the ring log."""
        if not rows.size:
            return
        if not np.all(rows["state"] == State.RUNNING):
            rows = rows[np.flatnonzero(rows["state"] != State.RUNNING)[-1] + 1 :]
            self._past = np.empty(0)
        reference = np.concatenate((self._past, rows["reference_N"]))
        first = self._whole + 1
        if reference.size > first:
            newer, older = reference[1 : reference.size - first + 1], reference[: reference.size - first]
            earlier = (1.0 - self._part) * newer + self._part * older
            self._sum_of_squares += float(np.sum(np.square(reference[first:] - earlier)))
            self.ticks += reference.size - first
        self._past = reference[-first:]

    def as_dict(self) -> dict[str, float | None]:
        """Lateness and cost, for the result of `piezod run`."""
        return {"late_s": self.late_s, "cost_rms_N": self.cost_N if self.ticks else None}

    def message(self) -> str:
        """One line of text about lateness and cost."""
        cost = f", which the model puts at {self.cost_N:.2f} N rms of the error" if self.ticks else ""
        return f"the reference is not known ahead: readings follow it {1e3 * self.late_s:.1f} ms late{cost}"


def missing_preview(bench: BenchConfig, model: Model) -> MissingPreview | None:
    """Make the sum for a bench; None if its reference is known ahead or its readings are not late."""
    if bench.compensation != "inverse" or not isinstance(bench.reference, (RegisterReference, StreamReference)):
        return None
    try:
        late_s = ExtendedCompensator(model, bench.dt_s, bench.compensation_without).late_s
    except ModelError:
        return None
    return MissingPreview(late_s, bench.rate_Hz) if late_s > 0.0 else None
