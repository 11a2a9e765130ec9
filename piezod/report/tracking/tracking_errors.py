"""Errors of a force that follows a reference, and the counters of the session that drove it."""

from dataclasses import asdict, dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from piezod.identify.scores import largest, max_hysteresis_percent, rms
from piezod.recording import Recording

FigureKey = tuple[str, str]  # reference, compensation
LABELS = {"gain": "plain gain", "inverse": "hysteresis inverse", "extended": "extended inverse"}


class SessionOutcome(Protocol):
    """Counters and end of a control process."""

    ticks: int
    missed: int
    failed_exchanges: int
    results: dict[str, int]
    fault: str
    stopped: bool
    warnings: list[str]
    resident_kib: int


@dataclass(frozen=True)
class TrackingFigures:
    """Errors of one reference; percentages refer to the range of the reference."""

    samples: int
    range_N: float
    rms_error_N: float
    rms_error_percent: float
    max_error_N: float
    max_error_percent: float
    max_hysteresis_percent: float | None

    @property
    def cells(self) -> list[str]:
        """Rms and largest error [N], each followed by its percentage, as text."""
        values = (self.rms_error_N, self.rms_error_percent, self.max_error_N, self.max_error_percent)
        return [f"{value:.2f}" for value in values]

    def as_dict(self) -> dict[str, float | int | None]:
        """Return the figures for JSON."""
        return asdict(self)


def tracking_figures(recording: Recording, *, loop: bool) -> TrackingFigures:
    """Compute the errors of a recording with `reference_N` and `force_N`.

    Parameters
    ----------
    recording
        Reference and measured force [N].
    loop
        Whether the reference rises and falls alike, so that a hysteresis loop is defined.

    Raises
    ------
    RecordingError
        The recording lacks one of the two channels.
    """
    reference, force = recording.channel("reference_N"), recording.channel("force_N")
    error = force - reference
    range_N = float(np.ptp(reference))
    return TrackingFigures(
        samples=int(force.size),
        range_N=range_N,
        rms_error_N=rms(error),
        rms_error_percent=100 * rms(error) / range_N,
        max_error_N=largest(error),
        max_error_percent=100 * largest(error) / range_N,
        max_hysteresis_percent=_max_hysteresis_percent(reference, force) if loop else None,
    )


def _max_hysteresis_percent(reference: NDArray[np.float64], force: NDArray[np.float64]) -> float | None:
    """Max hysteresis of a run; None if the run stopped before the reference turned back."""
    try:
        return max_hysteresis_percent(reference, force)
    except ValueError:
        return None
