"""A model in free run over a recording: only the input is looked at, and where needed a stated first stretch."""

import numpy as np

from piezod.errors import UsageError
from piezod.identify.identification import simulate
from piezod.identify.scores import largest, nrmse_percent, rms
from piezod.model import Model
from piezod.recording import Recording


def simulate_recording(model: Model, recording: Recording, start_window_s: float) -> tuple[Recording, str]:
    """Simulate the model's output over a recording's input.

    Parameters
    ----------
    model
        What was identified.
    recording
        Has the model's input; its output, where it has one, tells the start and is compared with.
    start_window_s
        First stretch that may be looked at to find what the memory starts with [s].

    Returns
    -------
    simulated, words
        A recording of `time_s` and the output column, and a sentence on start and errors.

    Raises
    ------
    RecordingError
        The recording has not the model's input.
    UsageError
        The input has missing samples.
    """
    u = recording.channel(model.input.channel)
    if not np.isfinite(u).all():
        raise UsageError(f"{recording.source}: {model.input.channel} has missing samples; cut the recording there")
    y = recording.channels.get(model.output.channel)
    window = int(np.searchsorted(recording.time_s, recording.time_s[0] + start_window_s))
    output, words = simulate(model, u, y if window else None, max(window, 1))
    if y is not None:
        good = np.isfinite(y)
        error, unit = (y - output)[good], model.output.unit
        words += (
            f"; rms error {rms(error):.4g} {unit}, max {largest(error):.4g} {unit}, "
            f"fit {nrmse_percent(y[good], output[good]):.2f} %"
        )
    return Recording(recording.time_s, {model.output.channel: output}, {"simulated": model.name}), words
