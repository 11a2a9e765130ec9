"""Read, identify, simulate, diagnose."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from piezod import __version__
from piezod.api.given import Given, Some, each_of, loaded_of, names_of, recording_of, source_of
from piezod.api.model import Model
from piezod.api.results import Diagnosed, Identified
from piezod.diagnose.diagnosis import diagnose as diagnosis_of
from piezod.errors import UsageError
from piezod.estimation.recordings.sources import Source, past_sources
from piezod.identify.identification import identify as identification_of
from piezod.identify.options import Options
from piezod.identify.simulation import simulate_recording
from piezod.model import file_sha256
from piezod.recording import Recording, TextOptions
from piezod.recording import read_recording as recording_from
from piezod.recording.conversion import choose_columns, in_units_of

OnStep = Callable[[str, float | None], None]


def read_recording(
    path: str | os.PathLike[str],
    *,
    columns: str | None = None,
    rate_Hz: float | None = None,
    decimal: Literal[".", ","] | None = None,
    scale: Sequence[str] = (),
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
        Conversions such as `"CH2=100 N/V"`.

    Raises
    ------
    RecordingError
        The file cannot be read, or needs a parameter, which the message names.
    """
    return recording_from(Path(path), TextOptions.of(columns, rate_Hz, decimal, scale))


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

    Raises
    ------
    RecordingError
        A recording cannot be used.
    """
    some = each_of(recordings)
    named = {"input": input, "output": output}
    input_name, output_name, notes = choose_columns(Path(source_of(some[0])), names_of(some[0]), named)
    options = Options(input=input_name, output=output_name, plays=plays, zones=dead_zones, name=name)
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
    return Identified(identification, tuple(recordings))


def simulate(recording: Given, model: Model | str | os.PathLike[str], *, start_window_s: float = 1.0) -> Recording:
    """Simulate a model in free run over the input of a recording.

    Parameters
    ----------
    recording
        A path, a `Recording` or a pandas frame. Its measured output serves only to estimate the start.
    model
        A model, or the path of its file.
    start_window_s
        First seconds from which the initial state is estimated, where the recording does not start at rest [s].

    Returns
    -------
    Recording
        `time_s` and the output channel.

    Raises
    ------
    RecordingError
        The recording lacks the model's input.
    """
    plant = _model(model)
    read, sha256 = recording_of(recording)
    read, _ = in_units_of(read, [plant.input.channel, plant.output.channel])
    return simulate_recording(plant, read, start_window_s, sha256=sha256).recording


def diagnose(
    recordings: Some,
    model: Model | Identified | str | os.PathLike[str],
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
        A model or the path of its file, or a result of `identify`. The recordings of the identification are compared
        too; with a result of `identify` they need no file.
    where
        Condition `COLUMN=VALUE` for the readings that count; None: all count.
    within_s
        Time for the diagnosis [s], above 0; None: no limit. Effects that were not compared in time are in the notes.
    on_step
        Called with the current step in words, and the share done or None.

    Raises
    ------
    RecordingError
        A recording cannot be used.
    UsageError
        A recording is given twice.
    """
    plant = model.model if isinstance(model, Identified) else _model(model)
    columns = plant.input.channel, plant.output.channel
    sources = []
    for given in each_of(recordings):
        recording, sha256 = recording_of(given)
        converted, notes = in_units_of(recording, columns)
        sources.append(Source(converted, sha256, "recording", where, tuple(notes)))
    hashes = {source.sha256 for source in sources}
    if len(hashes) < len(sources):
        raise UsageError("a recording is given twice, must be different ones")
    if isinstance(model, Identified):
        known = zip(model.recordings, plant.provenance.recordings, strict=True)
        past = [Source(r, entry.sha256, "identification") for r, entry in known if entry.sha256 not in hashes]
        notes = []
    else:
        folder = Path() if isinstance(model, Model) else Path(model).parent
        past, notes = past_sources(plant, folder, sources)
    notes = [*(note for source in sources for note in source.notes), *notes]
    parent = None if isinstance(model, Model | Identified) else file_sha256(Path(model))
    return Diagnosed(diagnosis_of(plant, sources, past, notes, on_step, within_s, parent))


def _model(model: Model | str | os.PathLike[str]) -> Model:
    return model if isinstance(model, Model) else Model.load(model)
