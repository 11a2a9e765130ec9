"""Diagnosis of one case: identifies a model, diagnoses the recordings, and simulates the held-out input."""

import time
from dataclasses import dataclass
from pathlib import Path

from piezod import __version__
from piezod.blind.case import Description, read_description
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.selection.replay import write_replay
from piezod.effects import EFFECTS
from piezod.estimation.recordings.intake import load_recordings
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.identify.simulation import simulate_recording
from piezod.model import Model, save_model
from piezod.recording import Recording, read_recording, write_csv

PLAYS, ZONES = 14, 6  # orders of the identified model
MODEL = "model.yaml"  # file of the identified model
REPLAY = "replay.json"  # file of the hypotheses that were tried
EXTENDED, BASE = "simulated_held_out.csv", "simulated_held_out_base.csv"
"""Files of the held-out simulations with the extended and with the identified model."""


@dataclass(frozen=True)
class Durations:
    """Durations of the two parts of the work.

    Parameters
    ----------
    identification_s, diagnosis_s
        Duration of the identification and of the diagnosis [s].
    """

    identification_s: float
    diagnosis_s: float


def diagnose_case(verdict: Path) -> Durations:
    """Diagnose the case in the current directory.

    The paths in the findings are plain file names, so they are equal on every machine.

    Parameters
    ----------
    verdict
        Folder for `findings.json`, the two simulations and the replay file; created if it does not exist.

    Raises
    ------
    RecordingError, ConfigurationError
        A file of the case cannot be read or is not suitable.
    """
    description = read_description(Path())
    begun_s = time.monotonic()
    model = identified(description)
    save_model(model, Path(MODEL))
    identified_s = time.monotonic()
    recordings = [Path(name) for name in description.recordings]
    diagnosis = diagnose_files(recordings, Path(MODEL), verdict, None, None, lambda *_: None)
    diagnosed_s = time.monotonic()
    (verdict / MODEL).unlink()  # not part of a verdict
    write_replay(verdict / REPLAY, diagnosis.attempts)
    drive = held_out_input(description)
    write_csv(simulated(model, drive), verdict / BASE)
    write_csv(simulated(repeatable(diagnosis.model), drive), verdict / EXTENDED)
    return Durations(identified_s - begun_s, diagnosed_s - identified_s)


def identified(description: Description, folder: Path = Path()) -> Model:
    """Model identified on the recording that the description names.

    Parameters
    ----------
    description
        Files and columns of a case.

    Raises
    ------
    RecordingError
        The recording cannot be read or is not suitable.
    """
    (loaded,) = load_recordings([folder / description.identification], description.input, description.output)
    return identify(
        [loaded.recording],
        Options(input=description.input, output=description.output, plays=PLAYS, zones=ZONES),
        f"piezod {__version__}",
        sources=[loaded.source],
        notes=loaded.notes,
    ).model


def held_out_input(description: Description) -> Recording:
    """Held-out recording without its output, so that no simulation can depend on it."""
    held_out = read_recording(Path(description.held_out))
    channels = {name: values for name, values in held_out.channels.items() if name != description.output}
    return Recording(held_out.time_s, channels, {}, description.held_out)


def repeatable(model: Model) -> Model:
    """Model without the effects that another recording does not repeat: tones, events and quantisation."""
    effects = tuple(effect for effect in model.effects if EFFECTS[effect.name].repeats)
    return model.model_copy(update={"effects": effects})


def simulated(model: Model, drive: Recording) -> Recording:
    """Free run of a model over the held-out input."""
    return simulate_recording(model, drive, 0.0).recording
