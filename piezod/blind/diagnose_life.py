"""Diagnosis of a life: each recording of work with the model that the step before has written, and no older file."""

import json
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np

from piezod.blind.case import Description, read_description
from piezod.blind.diagnose_case import Durations, held_out_input, identified, repeatable, simulated
from piezod.blind.verdict import FINDINGS, failed_verdict
from piezod.diagnose.command import diagnose_files
from piezod.diagnose.verdict.information import identified_information
from piezod.errors import PiezodError
from piezod.estimation.recordings.chosen_samples import outside
from piezod.estimation.recordings.intake import load_for_simulation
from piezod.estimation.recordings.sources import read_source
from piezod.identify.simulation import simulate_recording
from piezod.model import Model, load_model, save_model
from piezod.recording import Recording, write_csv

LIFE, SCHEMA = "life.json", "piezod.life/1"
SIMULATED = "simulated_held_out.csv"
MODEL = "model.yaml"
START_WINDOW_S = 1.0  # default of `piezod simulate` [s]


def diagnose_life(verdict: Path) -> Durations:
    """Diagnose the life in the current directory.

    A step whose diagnosis fails counts as wrong; the next step then has the model of the step before.

    Parameters
    ----------
    verdict
        Folder for `life.json`, the findings of the last step, and the simulations of the held-out input; created.

    Raises
    ------
    RecordingError, ConfigurationError
        The identification fails, or a file of the life cannot be read.
    """
    description = read_description(Path())
    verdict.mkdir(parents=True, exist_ok=True)
    begun_s = time.monotonic()
    given = Path("given_0.yaml")
    save_model(_with_information(identified(description), description), given)
    Path(description.identification).unlink()  # from now on, the model stands for it
    identified_s = time.monotonic()
    drive, entries = held_out_input(description), list[dict[str, Any]]()
    runs = {"generation_0_N": _output(load_model(given), drive)}
    for number, name in enumerate(description.recordings, 1):
        output = Path(f"step_{number}")
        entries.append(_step(given, Path(name), output))
        Path(name).unlink()
        if (output / MODEL).is_file():
            given = Path(shutil.copy(output / MODEL, f"given_{number}.yaml"))
        runs[f"generation_{number}_N"] = _output(load_model(given), drive)
    write_csv(Recording(drive.time_s, runs), verdict / SIMULATED)
    (verdict / LIFE).write_text(json.dumps({"schema": SCHEMA, "steps": entries}) + "\n", encoding="utf-8")
    last = entries[-1]["findings"]
    failed = failed_verdict(verdict.name, str(entries[-1]["failed"])).files[FINDINGS]
    (verdict / FINDINGS).write_bytes(failed if last is None else json.dumps(last, indent=2).encode())
    return Durations(identified_s - begun_s, time.monotonic() - identified_s)


def _with_information(model: Model, description: Description) -> Model:
    """Model with the information of its recording, as `piezod identify` writes it."""
    columns = description.input, description.output
    source = read_source(Path(description.identification), "identification", columns)
    return model.model_copy(update={"information": identified_information(model, [source])})


def _step(given: Path, recording: Path, output: Path) -> dict[str, Any]:
    """Findings of a step, the error of its given model as simulated, and figures of the written model."""
    model, findings, failed = load_model(given), None, None
    begun_s = time.process_time()
    try:
        diagnose_files([recording], given, output, None, None, lambda *_: None)
    except PiezodError as error:
        failed = str(error)
    cpu_s = time.process_time() - begun_s
    if failed is None:
        findings = json.loads((output / FINDINGS).read_text(encoding="utf-8"))
    written = output / MODEL if failed is None else given
    return {
        "recording": recording.name,
        "findings": findings,
        "failed": failed,
        "given": [effect.name for effect in model.effects],
        "simulated_rms": _simulated_rms(model, recording, findings),
        "effects": len(load_model(written).effects),
        "model_bytes": written.stat().st_size,
        "cpu_s": round(cpu_s, 3),
    }


def _simulated_rms(model: Model, path: Path, findings: dict[str, Any] | None) -> float:
    """Rms error of `piezod simulate`, without its mean, the first second, and stretches that the findings exclude."""
    loaded = load_for_simulation(path, model.input.channel, model.output.channel)
    run = simulate_recording(model, loaded.recording, START_WINDOW_S, sha256=loaded.sha256).recording
    error = loaded.recording.channel(model.output.channel) - run.channel(model.output.channel)
    entries = [] if findings is None else findings["recordings"]
    excluded = [f"{first!r}:{last!r}" for entry in entries for first, last in entry["left_out_s"]]
    started = loaded.recording.time_s >= loaded.recording.time_s[0] + START_WINDOW_S
    error = error[started & outside(loaded.recording, excluded)]
    return float(np.std(error[np.isfinite(error)]))


def _output(model: Model, drive: Recording) -> Any:  # noqa: ANN401  # array of shape (N,)
    return simulated(repeatable(model), drive).channel(model.output.channel)
