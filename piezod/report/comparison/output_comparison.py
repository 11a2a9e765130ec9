"""Measured outputs beside simulated ones: the fit as MATLAB's `compare` says it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from piezod.errors import UsageError
from piezod.identify.intake import load_for_simulation
from piezod.identify.simulation import Agreement, simulate_recording
from piezod.model import Model, load_model
from piezod.recording import Recording, read_recording

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """One simulated output and how well it fits.

    Parameters
    ----------
    name
        Of its file.
    values
        At the measured times, shape (N,), in the output's unit; nan beyond what it covers.
    agreement
        `nrmse_percent` is MATLAB's fit, 100 (1 - |y - yhat| / |y - mean(y)|).
    """

    name: str
    values: Array
    agreement: Agreement


@dataclass(frozen=True)
class Comparison:
    """A measurement and what is compared with it.

    Parameters
    ----------
    measured
        The recording.
    output
        Name of its column.
    candidates
        In the order given.
    """

    measured: Recording
    output: str
    candidates: list[Candidate]

    @property
    def best(self) -> Candidate:
        """With the highest fit."""
        return max(self.candidates, key=lambda one: one.agreement.nrmse_percent)


def compare_files(
    measured: Path, others: Sequence[Path], models: Sequence[Path], output: str | None, start_window_s: float
) -> Comparison:
    """Compare recordings of simulated outputs, and models in free run, with a measurement.

    Parameters
    ----------
    measured
        The recording that was measured.
    others
        Recordings of the same output; interpolated to the measured times, never beyond their own.
    models
        Simulated over the input of `measured`.
    output
        The column compared; None: the models', or `force_N`.
    start_window_s
        First stretch that may tell what a model's memory starts with; it is not compared [s].

    Raises
    ------
    UsageError
        Nothing is given to compare with, models have different outputs, or nothing is left to compare.
    RecordingError, ModelError
        A file cannot be used.
    """
    if not others and not models:
        raise UsageError("nothing to compare with: give another REC, or --model MODEL")
    loaded = [load_model(path) for path in models]
    outputs = {output} if output else {model.output.channel for model in loaded} or {"force_N"}
    if len(outputs) > 1 or any(model.output.channel not in outputs for model in loaded):
        raise UsageError(f"outputs differ: {', '.join(sorted(outputs | {one.output.channel for one in loaded}))}")
    name = outputs.pop()
    recording = read_recording(measured)
    y = recording.channel(name)
    names = _names([*others, *models])
    candidates = [_recorded(path, recording, y, name, names[path]) for path in others]
    candidates += [
        _simulated(names[path], model, measured, start_window_s) for path, model in zip(models, loaded, strict=True)
    ]
    return Comparison(recording, name, candidates)


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    """Stems of the files; their whole paths where two have the same."""
    stems = [path.stem for path in paths]
    return {path: path.stem if stems.count(path.stem) == 1 else str(path) for path in paths}


def _recorded(path: Path, recording: Recording, y: Array, name: str, label: str) -> Candidate:
    other = read_recording(path)
    values = np.interp(recording.time_s, other.time_s, other.channel(name), left=np.nan, right=np.nan)
    compared = np.isfinite(y) & np.isfinite(values)
    if not compared.any() or y[compared].min() == y[compared].max():
        raise UsageError(f"{path}: {np.count_nonzero(compared)} samples to compare with, need two that differ")
    return Candidate(label, values, Agreement.of(y[compared], values[compared]))


def _simulated(label: str, model: Model, measured: Path, start_window_s: float) -> Candidate:
    taken = load_for_simulation(measured, model.input.channel, model.output.channel)
    simulation = simulate_recording(model, taken.recording, start_window_s, None, taken.sha256)
    if simulation.agreement is None:
        raise UsageError(f"{measured}: has no {model.output.channel} to compare with")
    values = np.interp(
        taken.recording.time_s, simulation.recording.time_s, simulation.recording.channel(model.output.channel)
    )
    return Candidate(label, values, simulation.agreement)
