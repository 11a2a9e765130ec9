"""A model in free run over a recording.

The input drives the model. The measured output serves only to estimate the start, from a stated number of first
seconds. If the recording begins amid the range, the effect of its unknown past is fitted over all samples
(`estimation/recordings/unknown_past.py`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezod.arrays import Array
from piezod.errors import UsageError
from piezod.estimation.recordings.start import estimate_start, starts_at_rest
from piezod.estimation.recordings.unknown_past import fitted_past, unknown_past
from piezod.identify.scores import largest, nrmse_percent, rms
from piezod.model import Model, decays_of, run_chain
from piezod.recording import Recording

SLOPE_OVER = 0.01  # half width of the difference that gives the slope of the force law, as share of the input's range
FORGOTTEN = 1e-3
"""Strokes closer than this share of the input's range count as equal: it is the accuracy of a class 0.1 load cell."""


@dataclass(frozen=True)
class Agreement:
    """Errors between measurement and simulation.

    Parameters
    ----------
    rms, max, nrmse_percent
        Errors, measured minus simulated [output unit], [output unit], [%].
    rms_tared
        Standard deviation of the error, without its mean: the tare of the load cell is no model error [output unit].
    gain, offset
        Least-squares line measured = gain simulated + offset [1], [output unit].
    rms_refitted, max_refitted, nrmse_percent_refitted
        Errors after refitting gain and offset.
    """

    samples: int
    rms: float
    max: float
    nrmse_percent: float
    rms_tared: float
    gain: float
    offset: float
    rms_refitted: float
    max_refitted: float
    nrmse_percent_refitted: float

    @classmethod
    def of(cls, measured: Array, simulated: Array) -> "Agreement":
        """Compare two records, both shape (N,), finite and not constant [output unit]."""
        gain, offset = np.polynomial.Polynomial.fit(simulated, measured, 1).convert().coef[::-1]
        refitted = gain * simulated + offset
        return cls(
            samples=int(measured.size),
            rms=rms(measured - simulated),
            max=largest(measured - simulated),
            nrmse_percent=nrmse_percent(measured, simulated),
            rms_tared=float(np.std(measured - simulated)),
            gain=float(gain),
            offset=float(offset),
            rms_refitted=rms(measured - refitted),
            max_refitted=largest(measured - refitted),
            nrmse_percent_refitted=nrmse_percent(measured, refitted),
        )

    def words(self, unit: str) -> str:
        """The errors in a sentence."""
        return (
            f"over {self.samples} samples rms error {self.rms:.4g} {unit}, "
            f"{self.rms_tared:.4g} {unit} without its mean, "
            f"max {self.max:.4g} {unit}, fit {self.nrmse_percent:.2f} %; "
            f"with gain x {self.gain:.4f} and offset {self.offset:+.4g} {unit} "
            f"refitted {self.rms_refitted:.4g} {unit}, max {self.max_refitted:.4g} {unit}, "
            f"fit {self.nrmse_percent_refitted:.2f} %"
        )


@dataclass(frozen=True)
class Simulation:
    """A simulated recording.

    Parameters
    ----------
    recording
        `time_s` and the simulated output.
    start
        Initial state in words.
    agreement
        Errors against the measured output; None without one.
    """

    recording: Recording
    start: str
    agreement: Agreement | None


def simulate_recording(
    model: Model,
    recording: Recording,
    start_window_s: float,
    chosen: NDArray[np.bool_] | None = None,
    sha256: str | None = None,
) -> Simulation:
    """Simulate the model's output over a recording's input.

    Parameters
    ----------
    recording
        Holds the model's input. A measured output serves to estimate the start and is compared.
    start_window_s
        Duration from the first sample on in which the start is estimated and nothing is compared [s].
    chosen
        Mask of the compared samples, shape (N,); None: all. The simulation runs over every sample.
    sha256
        Hash of the recording's file, as hexadecimal text; None: unknown.

    Raises
    ------
    RecordingError
        The recording lacks the model's input.
    UsageError
        The input has missing samples, or no samples remain to compare.
    """
    u = recording.channel(model.input.channel)
    if not np.isfinite(u).all():
        raise UsageError(f"{recording.source}: {model.input.channel} has missing samples; cut the recording there")
    y = recording.channels.get(model.output.channel)
    window = int(np.searchsorted(recording.time_s, recording.time_s[0] + start_window_s))
    output, start = simulate(model, recording, window, sha256)
    agreement = None
    if y is not None:
        compared = np.isfinite(y) & (True if chosen is None else chosen)
        compared[:window] = False
        if not compared.any() or y[compared].min() == y[compared].max():  # a constant has no fit
            raise UsageError(
                f"{recording.source}: {np.count_nonzero(compared)} samples to compare, need two that differ"
            )
        agreement = Agreement.of(y[compared], output[compared])
    return Simulation(
        Recording(recording.time_s, {model.output.channel: output}, {"simulated": model.name}), start, agreement
    )


def simulate(model: Model, recording: Recording, window: int, sha256: str | None = None) -> tuple[Array, str]:
    """Free run of a model over a recording.

    Parameters
    ----------
    model
        An identified model, with or without effects.
    recording
        Holds the model's input column. If it also holds the output column, the start is estimated from its first
        `window` samples. In a recording that starts at rest, the estimate replaces the model's start only if it fits
        far better. If a recording begins amid the range, the effect of its past is fitted over all samples and added.
    window
        Number of samples that may be used to estimate the start, 0 or more; 0: none.
    sha256
        Hash of the recording's file, as hexadecimal text; some effects belong to one recording. None: unknown.

    Returns
    -------
    output, start
        Simulated output, shape (N,) [output unit], and the start in words.
    """
    operator, start = model.operator(), f"start of the model ({model.start.kind})"
    u, y = recording.channel(model.input.channel), recording.channels.get(model.output.channel)
    path: tuple[float, ...] = () if model.start.peak is None else (model.start.peak, 0.0)
    if y is not None and window > 0:
        reach = max(model.input.high, -model.input.low)
        estimate = estimate_start(model.operator(), u, y, window, model.input.unit, reach)
        if estimate is not None:
            path, start = estimate.path, estimate.words
            operator.set_states(np.zeros(operator.plays[0].size))
            operator.run(np.array(path))
    temperature_C = recording.channels.get("temperature_C")
    readings = run_chain(model, operator, recording.time_s, u, temperature_C=temperature_C, sha256=sha256, path_V=path)
    if y is not None and window > 0 and not starts_at_rest(u):
        past = _past_of(model, recording, path, y - readings, sha256)
        if past is not None:
            readings, start = readings + past, f"{start}; what came before is fitted"
    return readings, start


def _past_of(
    model: Model, recording: Recording, path: tuple[float, ...], error: Array, sha256: str | None
) -> Array | None:
    """Contribution of the unknown past to the readings, shape (N,) [output unit]; None: it has no effect."""
    u = recording.channel(model.input.channel)
    within = FORGOTTEN * (model.input.high - model.input.low)
    past = unknown_past(u, model.hysteresis.operator, (model.input.low, model.input.high), within)
    columns = []
    if past is not None:
        fading = past.columns[-1] == 0.0  # a lasting shift is a tare
        columns.append(_slope_of(model, path, u)[:, None] * past.columns[:, fading])
    columns += decays_of(model, recording.time_s, sha256)
    return fitted_past(error, np.hstack(columns)) if columns else None


def _slope_of(model: Model, path: tuple[float, ...], u: Array) -> Array:
    """Slope of the force law at each sample, shape (N,) [output unit per input unit]."""
    operator, half = model.hysteresis.operator(), SLOPE_OVER * (model.input.high - model.input.low)
    operator.run(np.array(path))
    stroke = operator.stroke(u)
    slope: Array = (operator.output(stroke + half) - operator.output(stroke - half)) / (2.0 * half)
    return slope
