"""What a peer may see of a case: the recordings, the held-out input, and the identified model's simulation of each.

The held-out force is dropped before anything is written for a peer, and the sealed truth is not opened here.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from piezod.blind.case import Description, read_description
from piezod.blind.diagnose_case import BASE, PLAYS, ZONES
from piezod.errors import ConfigurationError
from piezod.estimation.recordings.intake import load_recordings
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.identify.simulation import simulate_recording
from piezod.model import Model
from piezod.recording import Recording, read_csv, read_recording
from tests.studies.peers.exchange import GIVEN

SAME = 1e-5  # of the span: two simulations of one model, one of them printed


@dataclass(frozen=True)
class Given:
    """What peers are given of one case.

    Parameters
    ----------
    identification, recordings, held_out
        Columns by name; the last has no `force_N`.
    """

    identification: dict[str, np.ndarray]
    recordings: tuple[dict[str, np.ndarray], ...]
    held_out: dict[str, np.ndarray]

    @property
    def span_N(self) -> float:
        """Of the measured force in the recordings [N]."""
        force_N = np.concatenate([columns["force_N"] for columns in self.recordings])
        return float(np.ptp(force_N))

    def write(self, folder: Path) -> None:
        """Write it into an empty folder, for `exchange.read`."""
        names = [f"recording_{number}.npz" for number in range(1, len(self.recordings) + 1)]
        for name, columns in zip(names, self.recordings, strict=True):
            np.savez(folder / name, **columns)
        np.savez(folder / "identification.npz", **self.identification)
        np.savez(folder / "held_out.npz", **self.held_out)
        said = {"identification": "identification.npz", "recordings": names, "held_out": "held_out.npz"}
        (folder / GIVEN).write_text(json.dumps(said) + "\n", encoding="utf-8")


def given(case: Path, verdict: Path) -> Given:
    """What peers are given of a case; the model is identified as `piezod blind run` does.

    Parameters
    ----------
    case
        Its folder in the study.
    verdict
        What `piezod` said of it.

    Raises
    ------
    ConfigurationError
        The case or the verdict cannot be read, or the verdict's model is another one.
    """
    said = read_description(case)
    model = _identified(case, said)
    identification, *recordings = (
        _columns(model, read_recording(case / name), said) for name in (said.identification, *said.recordings)
    )
    held_out = _columns(model, _without(read_recording(case / said.held_out), said.output), said)
    _check_same(held_out["base_N"], verdict / BASE, said.output)
    return Given(identification, tuple(recordings), held_out)


def _identified(case: Path, said: Description) -> Model:
    taken = load_recordings([case / said.identification], said.input, said.output)
    options = Options(input=said.input, output=said.output, plays=PLAYS, zones=ZONES)
    return identify([one.recording for one in taken], options, "peers", sources=[one.source for one in taken]).model


def _without(recording: Recording, channel: str) -> Recording:
    channels = {name: values for name, values in recording.channels.items() if name != channel}
    return Recording(recording.time_s, channels, {}, recording.source)


def _columns(model: Model, recording: Recording, said: Description) -> dict[str, np.ndarray]:
    drive = _without(recording, said.output)
    base_N = simulate_recording(model, drive, 0.0).recording.channel(said.output)
    names = {said.input: "voltage_V", said.output: "force_N"}
    channels = {names.get(name, name): values for name, values in recording.channels.items()}
    return {"time_s": recording.time_s, "base_N": base_N, **channels}


def _check_same(base_N: np.ndarray, path: Path, output: str) -> None:
    """Refuse a verdict on another model; one that failed has no simulation to compare with."""
    if not path.is_file():
        return
    told_N = read_csv(path).channel(output)
    limit_N = SAME * float(np.ptp(told_N))
    apart_N = float(np.max(np.abs(told_N - base_N))) if told_N.shape == base_N.shape else np.inf
    if apart_N > limit_N:
        raise ConfigurationError(
            f"{path}: differs by {apart_N:.3g} N from the model identified now, must be within {limit_N:.3g} N; "
            "run piezod blind run again"
        )
