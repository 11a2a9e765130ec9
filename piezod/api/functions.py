"""Read, identify, simulate, diagnose."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from piezod import __version__
from piezod.api.arguments import check_callable, count_of, number_of, path_of, text_of, texts_of
from piezod.api.given import Given, Some, each_of, loaded_of, names_of, recording_of, source_of
from piezod.api.model import GivenModel, model_of
from piezod.api.results import Diagnosed, Identified
from piezod.diagnose.diagnosis import diagnose as diagnosis_of
from piezod.diagnose.verdict.information import identified_information
from piezod.errors import RecordingError, UsageError
from piezod.estimation.recordings.intake import LoadedRecording, OnStep
from piezod.estimation.recordings.sources import Source, past_sources
from piezod.identify.identification import identify as identification_of
from piezod.identify.options import Options
from piezod.identify.simulation import simulate_recording
from piezod.model import Model as Plant
from piezod.model import file_sha256
from piezod.recording import Recording, TextOptions
from piezod.recording import read_recording as recording_from
from piezod.recording.conversion import choose_columns, in_units_of


def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: str | None = None,
    rate_Hz: float | None = None,
    decimal: Literal[".", ","] | None = None,
    scale: str | Sequence[str] = (),
) -> Recording:
    """Read a recording of any supported format.

    Parameters
    ----------
    path
        File: text of any layout, xlsx, sqlite, HDF5, MAT, TDMS, Parquet, MDF4, LabVIEW measurement.
    columns
        Names of the columns with commas between, such as `"time_ms,voltage_V,force_N"`, or the wanted ones as
        `"time_s=run1/t,voltage_V=run1/u"`.
    rate_Hz
        Samples per second of a text file without a column of time [Hz].
    decimal
        Decimal mark of a text file.
    scale
        Conversions such as `"CH2=100 N/V"`, one or several.

    Returns
    -------
    Recording
        The channels of the file with their units, over time in seconds.

    Raises
    ------
    RecordingError
        The file cannot be read, or needs a parameter, which the message names.
    UsageError
        An argument is of a wrong kind or outside its limits.

    Examples
    --------
    >>> recording = piezod.read_recording("before.csv")
    >>> sorted(recording.channels)
    ['force_N', 'voltage_V']
    """
    conversions = texts_of(scale, "scale")
    rate = None if rate_Hz is None else number_of(rate_Hz, "rate_Hz", above=0.0)
    return recording_from(path_of(path), TextOptions.of(text_of(columns, "columns"), rate, decimal, conversions))


def identify(
    recordings: Some,
    *,
    input: str | None = None,  # noqa: A002  # as the option of the command
    output: str | None = None,
    plays: int | None = None,
    dead_zones: int | None = None,
    name: str = "stack",
    on_step: OnStep = lambda *_: None,
) -> Identified:
    """Identify a model.

    Parameters
    ----------
    recordings
        One or several: paths, `Recording` objects or pandas frames.
    input, output
        Names of their channels; None: voltage and force in any unit, else guessed from the names.
    plays, dead_zones
        Numbers of operators, 1 to 100 and 0 to 30; None: the fewest that fit to the noise.
    name
        Name of the model.
    on_step
        Called with the current step in words, and the share done, if known.

    Returns
    -------
    Identified
        The model, its errors on held-out data, and notes on the recordings.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    UsageError
        An argument is of a wrong kind or outside its limits.

    Examples
    --------
    >>> found = piezod.identify("before.csv")
    >>> found.useful
    True
    >>> found.model.save("model.yaml")
    """
    some = each_of(recordings)
    named = {"input": text_of(input, "input"), "output": text_of(output, "output")}
    n, m = count_of(plays, "plays", 1, 100), count_of(dead_zones, "dead_zones", 0, 30)
    check_callable(on_step, "on_step")
    if text_of(name, "name") is None:
        raise UsageError("name is None, must be text")
    input_name, output_name, notes = choose_columns(Path(source_of(some[0])), names_of(some[0]), named)
    options = Options(input=input_name, output=output_name, plays=n, zones=m, name=name)
    return identified(some, options, notes, on_step)


def identified(
    some: Sequence[Given], options: Options, notes: Sequence[str], on_step: OnStep, text: TextOptions | None = None
) -> Identified:
    """Read recordings, make them fit for use, and identify a model; both `identify` and the command call it.

    Parameters
    ----------
    some
        Paths, `Recording` objects or pandas frames. A file is read in pieces.
    notes
        Lines that stand before the other notes.
    on_step
        As for `identify`.
    text
        Layout of text files as the user states it; None: inferred from the files.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    loaded = [loaded_of(given, options.input, options.output, on_step, text) for given in some]
    recordings = [part.recording for part in loaded]
    identification = identification_of(
        recordings,
        options,
        f"piezod {__version__}",
        sources=[part.source for part in loaded],
        notes=[*notes, *(note for part in loaded for note in part.notes)],
        on_step=on_step,
    )
    if identification.useful:
        identification = replace(identification, model=_with_information(identification.model, loaded))
    return Identified(identification, tuple(recordings))


def simulate(recording: Given, model: GivenModel, *, start_window_s: float = 1.0) -> Recording:
    """Simulate a model in free run over the input of a recording.

    Parameters
    ----------
    recording
        A path, a `Recording` or a pandas frame. Its measured output serves only to estimate the start.
    model
        A model, a result of `identify` or `diagnose`, or the path of a model file.
    start_window_s
        First seconds from which the initial state is estimated, at least 0 [s]. It serves where the recording does not
        start at rest.

    Returns
    -------
    Recording
        `time_s` and the output channel.

    Raises
    ------
    RecordingError
        The recording has no samples, or lacks the model's input.
    ConfigurationError
        The model file cannot be read.
    UsageError
        An argument is of a wrong kind or outside its limits.

    Examples
    --------
    >>> simulated = piezod.simulate("later.csv", "model.yaml")
    >>> list(simulated.channels)
    ['force_N']
    """
    plant = model_of(model)
    window_s = number_of(start_window_s, "start_window_s", least=0.0)
    read, sha256 = recording_of(recording)
    if not read.time_s.size:
        raise RecordingError(f"{read.source}: has no samples, a simulation needs some")
    read, _ = in_units_of(read, [plant.input.channel, plant.output.channel])
    return simulate_recording(plant, read, window_s, sha256=sha256).recording


def diagnose(
    recordings: Some,
    model: GivenModel,
    *,
    where: str | None = None,
    within_s: float | None = None,
    on_step: OnStep = lambda *_: None,
) -> Diagnosed:
    """Find the effects that a model lacks.

    Parameters
    ----------
    recordings
        One or several recordings to explain: paths, `Recording` objects or pandas frames.
    model
        A model or the path of its file, or a result of `identify` or `diagnose`. The recordings of the identification
        are compared too; with a result of `identify` they need no file.
    where
        Condition `COLUMN=VALUE` for the readings that count; None: all count.
    within_s
        Time for the diagnosis [s], above 0; None: no limit. Effects that were not compared in time are in the notes.
    on_step
        Called with the current step in words, and the share done or None.

    Returns
    -------
    Diagnosed
        The verdict, the effects with their confidence, and the extended model.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    ConfigurationError
        The model file cannot be read.
    UsageError
        A recording is given twice, or an argument is of a wrong kind or outside its limits.

    Examples
    --------
    >>> diagnosis = piezod.diagnose("later.csv", found)
    >>> diagnosis.effects
    ('transport_delay',)
    """
    plant = model_of(model)
    text_of(where, "where")
    limit_s = None if within_s is None else number_of(within_s, "within_s", above=0.0)
    check_callable(on_step, "on_step")
    columns = plant.input.channel, plant.output.channel
    sources = []
    for given in each_of(recordings):
        recording, sha256 = recording_of(given)
        converted, notes = in_units_of(recording, columns)
        sources.append(Source(converted, sha256, "recording", where, tuple(notes)))
    if len({source.sha256 for source in sources}) < len(sources):
        raise UsageError("a recording is given twice, must be different ones")
    past, more = _past_of(model, plant, sources)
    notes = [*(note for source in sources for note in source.notes), *more]
    parent = file_sha256(Path(model)) if isinstance(model, str | os.PathLike) else None
    return Diagnosed(diagnosis_of(plant, sources, past, notes, on_step, limit_s, parent))


def _past_of(model: GivenModel, plant: Plant, sources: Sequence[Source]) -> tuple[list[Source], list[str]]:
    """Recordings of the identification that are not diagnosed now, and notes on missing ones."""
    if isinstance(model, Identified):
        hashes = {source.sha256 for source in sources}
        known = zip(model.recordings, plant.provenance.recordings, strict=True)
        return [Source(r, entry.sha256, "identification") for r, entry in known if entry.sha256 not in hashes], []
    folder = Path(model).parent if isinstance(model, str | os.PathLike) else Path()
    return past_sources(plant, folder, sources)


def _with_information(model: Plant, loaded: Sequence[LoadedRecording]) -> Plant:
    """Model with the information of its recordings; without it where a recording is too short for that."""
    sources = [Source(part.recording, part.sha256, "identification") for part in loaded]
    try:
        return model.model_copy(update={"information": identified_information(model, sources)})
    except RecordingError:
        return model
