"""Sentences of a diagnosis that the tool's own simulation contradicts.

The check reads what a user has: `findings.json`, the given and the written `model.yaml`, and the recordings. It
simulates both models as `piezod simulate` does. Errors are compared without their mean, since a tare is no mismatch.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from piezod.estimation.recordings.chosen_samples import outside
from piezod.estimation.recordings.intake import load_for_simulation
from piezod.identify.simulation import simulate_recording
from piezod.model import Model, load_model

START_WINDOW_S = 1.0  # default of `piezod simulate`
AGREES = 0.01  # largest relative difference of two errors of one model on one recording
ABOVE_NOISE = 1.3  # largest error of an explained recording [noise], as the README of `diagnose` promises
GROWS = 1.02  # from this factor on, a held-out recording counts as worse
OF_THE_READINGS = ("sensor_dropout", "quantisation")  # of one recording's device: they change no model
SURE = 0.6  # confidence of a name without "perhaps"


@dataclass(frozen=True)
class Result:
    """Files of one diagnosis.

    Parameters
    ----------
    given
        Model file that was given.
    output
        Folder with `findings.json` and `model.yaml`.
    recordings
        Recordings that were diagnosed.
    held_out
        Recordings given as `--hold-out`, or others of the same bench state that nothing was fitted to.
    """

    given: Path
    output: Path
    recordings: tuple[Path, ...]
    held_out: tuple[Path, ...] = ()

    @property
    def findings(self) -> dict[str, Any]:
        """Content of `findings.json`."""
        content: dict[str, Any] = json.loads((self.output / "findings.json").read_text(encoding="utf-8"))
        return content

    @property
    def written(self) -> Path:
        """The delivered model file."""
        return self.output / "model.yaml"


def simulated_rms(model: Model, paths: Sequence[Path], left_out: Mapping[str, Sequence[str]] | None = None) -> float:
    """Rms error of a free run over recordings, each without its mean and its start window [output unit].

    Parameters
    ----------
    model
        The model.
    paths
        Files of the recordings.
    left_out
        By their names, the stretches that the findings name as left out, as `simulate --leave-out` takes them.
    """
    apart = left_out or {}
    return float(np.sqrt(np.mean(np.concatenate([_squares(model, path, apart.get(path.name, ())) for path in paths]))))


def _squares(model: Model, path: Path, left_out: Sequence[str]) -> np.ndarray:
    loaded = load_for_simulation(path, model.input.channel, model.output.channel)
    simulated = simulate_recording(model, loaded.recording, START_WINDOW_S, sha256=loaded.sha256).recording
    error = loaded.recording.channel(model.output.channel) - simulated.channel(model.output.channel)
    started = loaded.recording.time_s >= loaded.recording.time_s[0] + START_WINDOW_S
    error = error[started & outside(loaded.recording, left_out)]
    error = error[np.isfinite(error)]
    return (error - error.mean()) ** 2


def contradictions(result: Result) -> list[str]:
    """One line for each statement that simulation contradicts; empty: none.

    Parameters
    ----------
    result
        Files of a diagnosis.
    """
    return list(_contradictions(result))


def _contradictions(result: Result) -> Iterator[str]:
    findings = result.findings
    given, written = load_model(result.given), load_model(result.written)
    left_out = {
        Path(one["path"]).name: [f"{first!r}:{last!r}" for first, last in one["left_out_s"]]
        for one in findings["recordings"]
    }
    before, after = (simulated_rms(model, result.recordings, left_out) for model in (given, written))
    told = findings["fit"]["held_out"]
    for name, value, simulated in (("before", told["before"], before), ("after", told["after"], after)):
        if abs(value - simulated) > AGREES * simulated:
            yield f"error {name} is {value:.4g}, simulate leaves {simulated:.4g}"
    floor, verdict = findings["noise_floor"]["value"], findings["verdict"]
    if verdict in {"matches", "explained"}:
        if floor is None:
            yield f"{verdict}, and the noise is unknown"
        elif after > ABOVE_NOISE * floor * (1.0 + AGREES):
            yield f"{verdict}, and simulate of the written model leaves {after / floor:.2f} noises"
    yield from _held_out(result, given, written, floor)
    yield from _names(findings, given)


def _held_out(result: Result, given: Model, written: Model, floor: float | None) -> Iterator[str]:
    findings = result.findings
    modelled = [one for one in findings["effects"] if one["name"] not in OF_THE_READINGS]
    sure = [one["name"] for one in modelled if one["confidence"] >= SURE]
    for path in result.held_out:
        first, second = simulated_rms(given, [path]), simulated_rms(written, [path])
        if sure and second > GROWS * first:
            yield f"{', '.join(sure)} at {SURE} or more, and {path.name} gets worse: {first:.4g} -> {second:.4g}"
        if findings["verdict"] == "explained" and floor and second > ABOVE_NOISE * floor:
            yield f"explained, and {path.name} is left with {second / floor:.2f} noises"


def _names(findings: dict[str, Any], given: Model) -> Iterator[str]:
    known = {effect.name for effect in given.effects}
    for one in findings["effects"]:
        if one["name"] in known and one.get("status", "new") == "new":
            yield f"{one['name']} is reported as new, the given model has it"
