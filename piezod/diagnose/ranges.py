"""Comparison of the ranges of a recording with those of the model: another unit, exchanged columns."""

from collections.abc import Sequence

import numpy as np

from piezod.errors import RecordingError
from piezod.estimation.recordings.series import Series
from piezod.model import Model

UNIT_FACTOR = 30.0
"""Ratio of two ranges that another unit explains: units differ by 1000, and a bench is driven to a thirtieth of its
range for the smallest minor loops."""

FOLLOWS = 0.9  # correlation of command and reading from which the reading shows the stack
EXTRAPOLATED = "beyond that the model is extrapolated"
BEYOND = 1.5  # ratio of the peaks from which the recording is named: a model says nothing about most of it


def compare_ranges(model: Model, series: Sequence[Series]) -> list[str]:
    """Notes on recordings that reach far beyond the range of the model.

    Raises
    ------
    RecordingError
        Command or gain of a recording differ from the model by a factor that only another unit explains.
    """
    notes = []
    for recording in series:
        if recording.role == "recording":
            notes += _command_notes(model, recording)
            _check_gain(model, recording)
    return notes


def _command_notes(model: Model, recording: Series) -> list[str]:
    """Note on a command beyond the model; RecordingError for another unit."""
    peak = max(abs(model.input.low), abs(model.input.high))
    reached = float(np.abs(recording.command_V).max())
    words = (
        f"{recording.name}: {model.input.channel} reaches {reached:.4g} {model.input.unit}, the model was identified "
        f"up to {peak:.4g} {model.input.unit}"
    )
    if not peak / UNIT_FACTOR <= reached <= UNIT_FACTOR * peak:
        raise RecordingError(f"{words}; {_unit_advice(model.input.channel)}")
    if reached <= BEYOND * peak:
        return []
    return [f"{words}; {'are the columns exchanged?' if _exchanged(model, recording) else EXTRAPOLATED}"]


def _exchanged(model: Model, recording: Series) -> bool:
    """Whether command and reading have the ranges of the model's reading and command."""
    pairs = ((recording.command_V, model.output), (recording.reading_N[recording.counts], model.input))
    ratios = [float(np.ptp(values)) / (channel.high - channel.low) for values, channel in pairs]
    return all(1.0 / BEYOND <= ratio <= BEYOND for ratio in ratios)


def _check_gain(model: Model, recording: Series) -> None:
    """Refuse readings that follow the command with a gain that only another unit explains."""
    counts = recording.counts & np.isfinite(recording.reading_N)
    command, reading = recording.command_V[counts], recording.reading_N[counts]
    if command.size < 2 or np.ptp(command) == 0.0 or np.ptp(reading) == 0.0:
        return
    gain = float(np.ptp(reading) / np.ptp(command))
    usual = (model.output.high - model.output.low) / (model.input.high - model.input.low)
    if usual / UNIT_FACTOR <= gain <= UNIT_FACTOR * usual:
        return
    if abs(np.corrcoef(command, reading)[0, 1]) > FOLLOWS:
        unit = f"{model.output.unit}/{model.input.unit}"
        raise RecordingError(
            f"{recording.name}: {model.output.channel} rises by {gain:.3g} {unit}, by {usual:.3g} {unit} in the model; "
            f"{_unit_advice(model.output.channel)}"
        )


def _unit_advice(channel: str) -> str:
    stem = channel.lstrip("-").rpartition("_")[0] or channel
    return f"is its unit right? State it with --columns, as in {stem}_UNIT, or with --scale"
