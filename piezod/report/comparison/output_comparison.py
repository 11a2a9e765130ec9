"""Fit of simulated outputs to a measured output, as MATLAB's `compare` defines it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezod.arrays import Array
from piezod.errors import UsageError
from piezod.estimation.recordings.intake import load_for_simulation
from piezod.estimation.recordings.noise import noise_of
from piezod.identify.simulation import Agreement, simulate_recording
from piezod.model import Model, load_model
from piezod.recording import Recording, read_recording
from piezod.report.ranking import Score


@dataclass(frozen=True)
class SimulatedOutput:
    """A simulated output and its fit to the measured output.

    Parameters
    ----------
    path
        File of the recording or of the model.
    values
        Output at the measured times, shape (N,), in the output's unit; nan outside its own time range.
    agreement
        Errors and fit. `nrmse_percent` is MATLAB's fit, 100 (1 - |y - yhat| / |y - mean(y)|).
    """

    name: str
    path: Path
    values: Array
    agreement: Agreement


@dataclass(frozen=True)
class Comparison:
    """A measured output and simulated outputs.

    Parameters
    ----------
    output
        Name of the compared column.
    simulated
        Simulated outputs, in the order of the arguments.
    noise
        Noise of the measured output [output unit]; None: unknown.
    """

    measured: Recording
    output: str
    simulated: list[SimulatedOutput]
    noise: float | None = None

    @property
    def ranked(self) -> list[SimulatedOutput]:
        """Simulated outputs, the highest fit first."""
        return sorted(self.simulated, key=lambda output: -output.agreement.nrmse_percent)

    @property
    def best(self) -> SimulatedOutput:
        """Simulated output with the highest fit."""
        return self.ranked[0]

    @property
    def scores(self) -> dict[str, Score]:
        """Rms error of each output."""
        return {output.name: Score(output.agreement.rms) for output in self.simulated}


def compare_files(
    measured: Path, others: Sequence[Path], models: Sequence[Path], output: str | None, start_window_s: float
) -> Comparison:
    """Compare recorded simulations, and models in free run, with a measured output.

    Parameters
    ----------
    others
        Recordings of simulated outputs, interpolated to the measured times within their own time range.
    models
        Models to simulate over the input of `measured`.
    output
        Column to compare; None: the output of the models, or `force_N` without models.
    start_window_s
        Length of the start of the recording that estimates the initial state and is not compared [s].

    Raises
    ------
    UsageError
        No output to compare with exists, the models have different outputs, or no common samples exist.
    RecordingError, ModelError
        A file cannot be used.
    """
    if not others and not models:
        raise UsageError("nothing to compare with: give another REC, or --model MODEL")
    loaded = [load_model(path) for path in models]
    outputs_of_models = {model.output.channel for model in loaded}
    outputs = {output} if output else outputs_of_models or {"force_N"}
    if len(outputs) > 1 or not outputs_of_models <= outputs:
        raise UsageError(f"outputs differ: {', '.join(sorted(outputs | outputs_of_models))}; compare one output")
    name = outputs.pop()
    recording = read_recording(measured)
    y = recording.channel(name)
    names = _names([*others, *models])
    simulated = [_recorded(path, recording, y, name, names[path]) for path in others]
    simulated += [
        _simulated(path, names[path], model, measured, start_window_s)
        for path, model in zip(models, loaded, strict=True)
    ]
    return Comparison(recording, name, simulated, _noise(recording, y, loaded))


def _noise(recording: Recording, y: Array, models: Sequence[Model]) -> float | None:
    """Noise from repeats or rests of the recording, else the least noise that a model states; None: unknown.

    The noise of a model is an upper bound: it holds the misfit where its recordings show no noise.
    """
    column = models[0].input.channel if models else "voltage_V"
    u = recording.channels.get(column)
    found = None if u is None or not np.isfinite(u).all() else noise_of(u, y, np.isfinite(y), recording.dt_s)
    known = [model.information.noise for model in models if model.information is not None]
    return found.rms if found is not None else min(known, default=None)


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Names of the files without suffix, with as many folders as make them unique."""
    parts = {path: path.resolve().with_suffix("").parts for path in paths}
    deepest = max(map(len, parts.values()))
    names = {}
    for path in paths:
        ends = (sum(other[-count:] == parts[path][-count:] for other in parts.values()) for count in range(1, deepest))
        count = next((count for count, same in enumerate(ends, 1) if same == 1), deepest)
        names[path] = "/".join(parts[path][-count:])
    return names


def _recorded(path: Path, recording: Recording, y: Array, name: str, label: str) -> SimulatedOutput:
    other = read_recording(path)
    values = np.interp(recording.time_s, other.time_s, other.channel(name), left=np.nan, right=np.nan)
    compared = np.isfinite(y) & np.isfinite(values)
    if not compared.any() or y[compared].min() == y[compared].max():
        count = np.count_nonzero(compared)
        raise UsageError(f"{path}: {count} samples in common with the measurement, need at least two that differ")
    return SimulatedOutput(label, path, values, Agreement.of(y[compared], values[compared]))


def _simulated(path: Path, label: str, model: Model, measured: Path, start_window_s: float) -> SimulatedOutput:
    loaded = load_for_simulation(measured, model.input.channel, model.output.channel)
    simulation = simulate_recording(model, loaded.recording, start_window_s, None, loaded.sha256)
    if simulation.agreement is None:
        raise UsageError(f"{measured}: has no column {model.output.channel} to compare with")
    values = np.interp(
        loaded.recording.time_s, simulation.recording.time_s, simulation.recording.channel(model.output.channel)
    )
    return SimulatedOutput(label, path, values, simulation.agreement)
