"""Free runs of a model over recordings: the source of the errors before and after a diagnosis."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.diagnose.prepare import as_identified
from piezod.errors import RecordingError
from piezod.estimation.recordings.intake import fit_for_simulation
from piezod.estimation.recordings.series import Series
from piezod.estimation.recordings.sources import Source
from piezod.identify.simulation import simulate
from piezod.model import Model
from piezod.recording import Recording
from piezod.recording.stretches import stretches_of

START_WINDOW_S = 1.0
"""First part of a recording, which estimates its initial state and is not compared: as in `piezod simulate`."""


@dataclass(frozen=True)
class FreeRun:
    """A model in free run over a recording.

    Parameters
    ----------
    left_out_s
        First and last time of each stretch whose readings do not count, such as frozen ones [s].
    expected, error
        Expected readings, and measured less expected readings (nan where not compared), shape (N,) [output unit].
    """

    recording: Recording
    left_out_s: tuple[tuple[float, float], ...]
    expected: Array
    error: Array

    @property
    def tare(self) -> float:
        """Mean error [output unit]: the offset of the load cell, which is no error of the model."""
        return float(np.nanmean(self.error)) if np.isfinite(self.error).any() else 0.0

    def at_samples_of(self, series: Series) -> Array:
        """Expected readings with the tare at the samples of a series, shape (N,) [output unit]."""
        return np.interp(series.start_s + series.time_s, self.recording.time_s, self.expected) + self.tare


def free_run(model: Model, source: Source, series: Series | None = None) -> FreeRun:
    """Simulate a model over a recording as `piezod simulate` does.

    Parameters
    ----------
    model
        Given or written model, with its effects, unnamed law, hold and signs.
    series
        Prepared recording; its excluded readings are not compared. It replaces a recording that cannot be simulated
        because its input has a long gap. None: a held-out recording.

    Raises
    ------
    RecordingError
        A held-out recording cannot be simulated.
    """
    try:
        recording, _ = fit_for_simulation(source.recording, model.input.channel, model.output.channel)
    except RecordingError:
        if series is None:
            raise
        recording = _recording_of(series, model)
    window = int(np.searchsorted(recording.time_s, recording.time_s[0] + START_WINDOW_S))
    expected, _ = simulate(model, recording, window, source.sha256)
    measured = recording.channel(model.output.channel)
    compared = np.isfinite(measured)
    excluded = np.zeros(compared.size, bool) if series is None else compared & ~_counting(series, recording.time_s)
    compared &= ~excluded
    if compared[window:].any():  # a recording of less than a second is compared from its first sample on
        compared[:window] = False
    left_out_s = tuple((float(recording.time_s[a]), float(recording.time_s[b - 1])) for a, b in stretches_of(excluded))
    return FreeRun(recording, left_out_s, expected, np.where(compared, measured - expected, np.nan))


def _counting(series: Series, time_s: Array) -> NDArray[np.bool_]:
    """Mask of the times whose readings count in the series, shape (N,); times outside the series count."""
    place = np.searchsorted(series.start_s + series.time_s, time_s - 0.5 * series.dt_s)
    inside = (time_s > series.start_s - 0.5 * series.dt_s) & (place < series.time_s.size)
    return ~inside | series.counts[np.minimum(place, series.time_s.size - 1)]


def _recording_of(series: Series, model: Model) -> Recording:
    readings = np.where(series.counts, series.reading_N, np.nan)
    channels = {model.input.channel: series.command_V, model.output.channel: readings}
    if series.temperature_C is not None:
        channels["temperature_C"] = series.temperature_C
    return Recording(series.start_s + series.time_s, channels, {}, series.name)


def tared_rms(runs: Sequence[FreeRun]) -> float:
    """Rms error over several recordings, each without its mean [output unit]."""
    errors = [run.error[np.isfinite(run.error)] for run in runs]
    return float(np.sqrt(np.mean(np.concatenate([np.square(error - error.mean()) for error in errors]))))


@dataclass(frozen=True)
class GivenRuns:
    """Free runs of the given model over every recording.

    Parameters
    ----------
    runs
        Free run over each recording; over an identification recording without effects that appeared later.
    without_law
        Free runs without the unnamed law of the model; empty if it has no law.
    """

    runs: list[FreeRun]
    diagnosed: list[tuple[Source, Series]]
    without_law: list[FreeRun]

    @classmethod
    def of(cls, model: Model, sources: Sequence[Source], series: Sequence[Series]) -> "GivenRuns":
        """Simulate the model over the recordings, identification recordings first."""
        pairs = list(zip(sources, series, strict=True))
        by_role = {"identification": as_identified(model), "recording": model}
        runs = [free_run(by_role[source.role], source, prepared) for source, prepared in pairs]
        without_law: list[FreeRun] = []
        if model.unnamed_law is not None:
            plain = {role: one.model_copy(update={"unnamed_law": None}) for role, one in by_role.items()}
            without_law = [free_run(plain[source.role], source, prepared) for source, prepared in pairs]
        return cls(runs, [pair for pair in pairs if pair[0].role == "recording"], without_law)

    @property
    def diagnosed_runs(self) -> list[FreeRun]:
        """Free runs over the diagnosed recordings, which are the last."""
        return self.runs[-len(self.diagnosed) :]

    @property
    def law_holds(self) -> bool:
        """Whether the unnamed law does not increase the error; True if the model has none."""
        if not self.without_law:
            return True
        return tared_rms(self.diagnosed_runs) <= tared_rms(self.without_law[-len(self.diagnosed) :])

    def law_readings(self, series: Sequence[Series]) -> list[Array]:
        """Share of the unnamed law in the readings of each recording [output unit].

        Shape (N,) each, or (1,) with the value 0 if the model has no law or the law does not hold.
        """
        if not self.without_law or not self.law_holds:
            return [np.zeros(1)] * len(series)
        return [
            run.at_samples_of(prepared) - plain.at_samples_of(prepared) - run.tare + plain.tare
            for run, plain, prepared in zip(self.runs, self.without_law, series, strict=True)
        ]
