"""Fit of simulated outputs to a measured output, as MATLAB's `compare` defines it: figures, text, JSON and page."""

import html
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bokeh.plotting import figure

from piezod.arrays import Array
from piezod.diagnose.verdict.words import unit_words
from piezod.errors import UsageError
from piezod.estimation.recordings.intake import load_for_simulation
from piezod.estimation.recordings.noise import noise_of
from piezod.identify.simulation import Agreement, simulate_recording
from piezod.model import Model, load_model
from piezod.recording import Recording, read_recording
from piezod.report.figures.layout import finish_figure, labelled_figure
from piezod.report.figures.thinning import envelope, envelope_times, robust_range
from piezod.report.next_step import NextStep
from piezod.report.page import axis_label, table_html, write_page
from piezod.report.ranking import Score, gain_text, in_noises
from piezod.report.style import BLUE, GREEN, GREY, ORANGE, RED
from piezod.report.text_table import text_table

COLOURS = (BLUE, ORANGE, GREEN, RED)
POINTS = 3000  # of a drawn curve
HEADER = ("", "fit, NRMSE [%]", "rms error", "max error", "gain", "offset", "fit refitted [%]")


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


def comparison_as_dict(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison for JSON.

    Parameters
    ----------
    comparison
        Measured and simulated outputs with their agreement.
    """
    return {
        "schema": "piezod.comparison/1",
        "measured": comparison.measured.source,
        "output": comparison.output,
        "unit": _unit(comparison.output),
        "noise": comparison.noise,
        "compared": [{"name": output.name} | asdict(output.agreement) for output in comparison.simulated],
    }


def comparison_text(comparison: Comparison) -> str:
    """Format the comparison as text: one line for each output, then the best fit in a sentence.

    Parameters
    ----------
    comparison
        Measured and simulated outputs with their agreement.
    """
    return "\n".join([*text_table([HEADER, *_rows(comparison)]), _verdict(comparison)])


def write_comparison_page(path: Path, comparison: Comparison, step: NextStep | None = None) -> None:
    """Write the page: best fit, table, outputs and errors over time.

    Parameters
    ----------
    step
        Next step of the command; None: the page has none.

    Raises
    ------
    ConfigurationError
        The file cannot be written.
    """
    note = (
        "Fit: 100 (1 - |y - yhat| / |y - mean(y)|), as in MATLAB. "
        "Fit refitted: the same after the best gain and offset are applied to the simulated output."
    )
    outputs, errors = _outputs_and_errors(comparison)
    head = f"Comparison with {Path(comparison.measured.source).name}", _verdict(comparison)
    table = table_html(HEADER, _rows(comparison))
    write_page(path, "Comparison", head, [table, [outputs], [errors], f"<p class='dim'>{html.escape(note)}</p>"], step)


def _outputs_and_errors(comparison: Comparison) -> tuple[figure, figure]:
    recording = comparison.measured
    name = comparison.output
    y = recording.channel(name)
    shown_s = envelope_times(recording.time_s, POINTS)
    outputs = labelled_figure("Measured and simulated", "time [s]", axis_label(name), 340)
    outputs.line(shown_s, envelope(y, POINTS), color=GREY, line_width=3, legend_label="measured")
    errors = labelled_figure(
        "Measured less simulated",
        "time [s]",
        f"error [{unit_words(_unit(name))}]",
        260,
        x_range=outputs.x_range,
        y_range=robust_range(*(y - output.values for output in comparison.simulated)),
    )
    for number, output in enumerate(comparison.simulated):
        colour = COLOURS[number % len(COLOURS)]
        outputs.line(shown_s, envelope(output.values, POINTS), color=colour, legend_label=output.name)
        errors.line(shown_s, envelope(y - output.values, POINTS), color=colour, legend_label=output.name)
    return finish_figure(outputs), finish_figure(errors)


def _rows(comparison: Comparison) -> list[list[str]]:
    unit = unit_words(_unit(comparison.output))
    return [_cells(output, unit) for output in comparison.simulated]


def _cells(output: SimulatedOutput, unit: str) -> list[str]:
    agreement = output.agreement
    return [
        output.name,
        f"{agreement.nrmse_percent:.2f}",
        f"{agreement.rms:.4g} {unit}",
        f"{agreement.max:.4g} {unit}",
        f"{agreement.gain:.4f}",
        f"{agreement.offset:+.4g} {unit}",
        f"{agreement.nrmse_percent_refitted:.2f}",
    ]


def _verdict(comparison: Comparison) -> str:
    best = comparison.best
    noise, unit = comparison.noise, unit_words(_unit(comparison.output))
    sentence = f"{best.name} fits with {best.agreement.nrmse_percent:.2f} %"
    error = f"rms error {in_noises(best.agreement.rms, noise, unit)}" + (f" of {noise:.2g} {unit}" if noise else "")
    if len(comparison.simulated) == 1:
        return f"{sentence}; {error}"
    second = comparison.ranked[1].name
    gain = gain_text(best.name, second, comparison.scores, noise, unit)
    return f"{sentence}, best of {len(comparison.simulated)}; {error}; {gain}"


def _unit(column: str) -> str:
    return column.rpartition("_")[2]
