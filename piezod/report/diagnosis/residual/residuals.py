"""Residuals of a recording under both models, and the recording that each place in time belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezod.arrays import Array
from piezod.diagnose.findings import Place
from piezod.estimation.recordings.series import Series


@dataclass(frozen=True)
class Residuals:
    """A diagnosed recording with the outputs of both models.

    Parameters
    ----------
    given, extended
        Output of the given model and of the extended model, shape (N,).
    """

    series: Series
    given: Array
    extended: Array

    @property
    def time_s(self) -> Array:
        """Time stamps of the recording, shape (N,) [s]."""
        return self.series.start_s + self.series.time_s

    @property
    def measured(self) -> Array:
        """Readings, shape (N,); nan where missing."""
        known = self.series.counts | (self.series.reading_N != 0.0)
        return np.where(known, self.series.reading_N, np.nan)

    @property
    def before(self) -> Array:
        """Reading minus given model, shape (N,); 0 where a reading was rejected."""
        return np.where(self.series.counts, self.series.reading_N - self.given, 0.0)

    @property
    def after(self) -> Array:
        """Reading minus extended model, shape (N,); 0 where a reading was rejected."""
        return np.where(self.series.counts, self.series.reading_N - self.extended, 0.0)


def recordings_of_places(places: Sequence[Place], recordings: Sequence[Residuals]) -> dict[Place, Residuals]:
    """Assign each place in time to the recording with the largest squared error there, relative to its noise.

    A place has no name of a recording, and each recording has its own time.

    Parameters
    ----------
    places
        Places on any axis; only those on `time_s` count.
    recordings
        Recordings with their residuals, at least one.
    """

    def squared_error(recording: Residuals, place: Place) -> float:
        inside = slice(*np.searchsorted(recording.time_s, (place.low, place.high)))
        error = recording.series.reading_N[inside] - recording.given[inside]
        return float(error @ error) / recording.series.noise_N**2

    def recording_of(place: Place) -> Residuals:
        return max(recordings, key=lambda recording: squared_error(recording, place))

    return {place: recording_of(place) for place in places if place.axis == "time_s"}
