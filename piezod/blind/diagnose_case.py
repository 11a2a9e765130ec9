"""One case judged as an engineer would: a model identified, the recordings diagnosed, the held-out input simulated."""

import time
from dataclasses import dataclass
from pathlib import Path

from piezod import __version__
from piezod.blind.case import Description, read_description
from piezod.diagnose.command import diagnose_files
from piezod.identify.identification import Options, identify
from piezod.identify.intake import load_recordings
from piezod.identify.simulation import simulate_recording
from piezod.model import Model, save_model
from piezod.recording import Recording, read_recording, write_csv

PLAYS, ZONES = 14, 6
MODEL = "model.yaml"
EXTENDED, BASE = "simulated_held_out.csv", "simulated_held_out_base.csv"
UNREPEATED = frozenset({"vibration", "mains_hum", "load_step", "sensor_dropout", "quantisation"})
"""Tones, one-off events and the converter: another recording does not repeat them sample by sample."""


@dataclass(frozen=True)
class Took:
    """How long it took.

    Parameters
    ----------
    identification_s, diagnosis_s
        To identify the model, and to diagnose with it [s].
    """

    identification_s: float
    diagnosis_s: float


def judge(verdict: Path) -> Took:
    """Judge the case in the current directory.

    Its own names are all that a verdict says of files, wherever it was judged.

    Parameters
    ----------
    verdict
        Folder, made where it is not there; `findings.json` and the two simulations go there.

    Raises
    ------
    RecordingError, ConfigurationError
        A file of the case cannot be used.
    """
    said = read_description(Path())
    begun_s = time.monotonic()
    model = _identified(said)
    save_model(model, Path(MODEL))
    identified_s = time.monotonic()
    recordings = [Path(name) for name in said.recordings]
    diagnosis = diagnose_files(recordings, Path(MODEL), verdict, None, None, lambda *_: None)
    diagnosed_s = time.monotonic()
    (verdict / MODEL).unlink()  # no part of a verdict
    drive = _drive(said)
    write_csv(_simulated(model, drive), verdict / BASE)
    write_csv(_simulated(_repeatable(diagnosis.model), drive), verdict / EXTENDED)
    return Took(identified_s - begun_s, diagnosed_s - identified_s)


def _identified(said: Description) -> Model:
    taken = load_recordings([Path(said.identification)], said.input, said.output)
    return identify(
        [one.recording for one in taken],
        Options(input=said.input, output=said.output, plays=PLAYS, zones=ZONES),
        f"piezod {__version__}",
        sources=[one.source for one in taken],
        notes=[note for one in taken for note in one.notes],
    ).model


def _drive(said: Description) -> Recording:
    """The held-out record without its output: nothing of it may be looked at."""
    held_out = read_recording(Path(said.held_out))
    channels = {name: values for name, values in held_out.channels.items() if name != said.output}
    return Recording(held_out.time_s, channels, {}, said.held_out)


def _repeatable(model: Model) -> Model:
    return model.model_copy(update={"effects": tuple(one for one in model.effects if one.name not in UNREPEATED)})


def _simulated(model: Model, drive: Recording) -> Recording:
    return simulate_recording(model, drive, 0.0).recording
