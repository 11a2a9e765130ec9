"""What `piezod simulate` of a model leaves on a recording: the errors before and after a diagnosis are these."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.diagnose.hypothesis.series import Series
from piezod.diagnose.prepare import Source, as_identified
from piezod.errors import RecordingError
from piezod.identify.intake import fit_for_simulation
from piezod.identify.simulation import simulate
from piezod.model import Model
from piezod.recording import Recording
from piezod.recording.stretches import stretches_of

Array = NDArray[np.float64]

START_WINDOW_S = 1.0
"""First stretch in which the start of a recording is found, and which is not compared: as `piezod simulate` has it."""


@dataclass(frozen=True)
class FreeRun:
    """A model in free run over a recording.

    Parameters
    ----------
    recording
        As it is simulated.
    left_out_s
        First and last time of each stretch whose readings were taken for no force, and are not compared [s].
    expected, error
        Expected readings, and measured less expected where it is compared, else nan, shape (N,) [output unit].
    """

    recording: Recording
    left_out_s: tuple[tuple[float, float], ...]
    expected: Array
    error: Array

    @property
    def tare(self) -> float:
        """Mean error [output unit]: an offset of the load cell is no error of the model."""
        return float(np.nanmean(self.error)) if np.isfinite(self.error).any() else 0.0

    def over(self, series: Series) -> Array:
        """Expected readings at the samples of a series, the tare added, shape (samples,) [output unit]."""
        return np.interp(series.start_s + series.time_s, self.recording.time_s, self.expected) + self.tare


def free_run(model: Model, source: Source, series: Series | None = None) -> FreeRun:
    """Simulate a model over a recording as `piezod simulate` does.

    Parameters
    ----------
    model
        Given or written model, with its effects, its law, its hold and its signs.
    source
        The recording.
    series
        The same as it is diagnosed: readings that do not count there are not compared. Where the recording cannot be
        simulated because its input is missing for long, the model runs over this part of it. None: it was held out.

    Raises
    ------
    RecordingError
        A recording that was held out cannot be simulated.
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
    doubted = np.zeros(compared.size, bool) if series is None else compared & ~_counting(series, recording.time_s)
    compared &= ~doubted
    if compared[window:].any():  # a recording of less than a second is compared whole
        compared[:window] = False
    left_out_s = tuple((float(recording.time_s[a]), float(recording.time_s[b - 1])) for a, b in stretches_of(doubted))
    return FreeRun(recording, left_out_s, expected, np.where(compared, measured - expected, np.nan))


def _counting(series: Series, time_s: Array) -> NDArray[np.bool_]:
    """Which samples of a recording count in the diagnosis, shape (N,); all of those that it leaves out at the begin."""
    place = np.searchsorted(series.start_s + series.time_s, time_s - 0.5 * series.dt_s)
    inside = (time_s > series.start_s - 0.5 * series.dt_s) & (place < series.time_s.size)
    return ~inside | series.counts[np.minimum(place, series.time_s.size - 1)]


def _recording_of(series: Series, model: Model) -> Recording:
    readings = np.where(series.counts, series.reading_N, np.nan)
    channels = {model.input.channel: series.command_V, model.output.channel: readings}
    if series.temperature_C is not None:
        channels["temperature_C"] = series.temperature_C
    return Recording(series.start_s + series.time_s, channels, {}, series.name)


def run_over(model: Model, series: Series) -> Array:
    """Expected readings of the recording that stands for those of the identification, shape (N,) [output unit]."""
    return simulate(model, _recording_of(series, model), 0)[0]


def tared_rms(runs: Sequence[FreeRun]) -> float:
    """Rms error over several recordings, each about its mean [output unit]."""
    errors = [one.error[np.isfinite(one.error)] for one in runs]
    return float(np.sqrt(np.mean(np.concatenate([np.square(one - one.mean()) for one in errors]))))


@dataclass(frozen=True)
class GivenRuns:
    """The given model in free run over every recording.

    Parameters
    ----------
    runs
        Of the whole model; over recordings of its identification of what was there at that time.
    places
        Recordings asked about, each with its series.
    without_law
        The same without its unnamed law; empty where it has none.
    """

    runs: list[FreeRun]
    places: list[tuple[Source, Series]]
    without_law: list[FreeRun]

    @classmethod
    def of(cls, model: Model, sources: Sequence[Source], series: Sequence[Series]) -> "GivenRuns":
        """Simulate the model over the recordings."""
        then = as_identified(model)
        by_role = {"identification": then, "recording": model}
        pairs = list(zip(sources, series, strict=True))
        runs = [free_run(by_role[source.role], source, one) for source, one in pairs]
        plain: list[FreeRun] = []
        if model.unnamed_law is not None:
            by_role["recording"] = model.model_copy(update={"unnamed_law": None})
            plain = [free_run(by_role[source.role], source, one) for source, one in pairs]
        return cls(runs, [pair for pair in pairs if pair[0].role == "recording"], plain)

    @property
    def asked(self) -> list[FreeRun]:
        """Those of the recordings asked about, which are the last."""
        return self.runs[-len(self.places) :]

    @property
    def law_holds(self) -> bool:
        """Whether the given model leaves no more with its unnamed law than without it; True where it has none."""
        asked = slice(-len(self.places), None)
        return not self.without_law or tared_rms(self.runs[asked]) <= tared_rms(self.without_law[asked])

    def law(self, series: Sequence[Series]) -> list[Array]:
        """What the given law adds to the readings of every recording, shape (N,) or (1,) [output unit]; 0: it fails."""
        if not self.without_law or not self.law_holds:
            return [np.zeros(1)] * len(series)
        return [
            run.over(one) - plain.over(one) - run.tare + plain.tare
            for run, plain, one in zip(self.runs, self.without_law, series, strict=True)
        ]
