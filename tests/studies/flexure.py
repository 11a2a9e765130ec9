"""Prediction of a real feedforward by a diagnosed model: the recorded stack of `piezo-flexure`.

Only recordings of this stack exist. Its author followed a sine with the inverse of a backlash model. One model is
identified on the identification recording. A second one also uses the first part of the tracking recording, which is
then diagnosed; the rest is held out. The tracking error of an exact inverse equals the simulation error of its model.
So the free run of each model over the held-out part predicts the remaining error, beside the recorded one. Then the
inverse plans the voltages for the reference of the author, and the forward chain simulates them within the range.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from piezod.effects import EFFECTS
from piezod.identify.simulation import simulate_recording
from piezod.model import ExtendedCompensator, Model, acting_effects, load_model
from piezod.model.chain.forward import run_chain
from piezod.recording import Recording, read_csv, write_csv
from tests.studies.scenarios import ROOT, run

REAL = ROOT.parent / "shared" / "recordings" / "piezo-flexure"
COLUMNS = ("--input", "voltage_V", "--output", "displacement_um")
HELD_OUT_FROM_S = 56.0  # the last stretch with the author's feedforward on, after the second hold
START_WINDOW_S = 1.0
SETTLES_S = 1.0


@dataclass(frozen=True)
class FlexureRow:
    """One feedforward over the held-out part [um].

    Parameters
    ----------
    feedforward
        Name of the feedforward.
    rms_um, largest_um
        Rms and largest error without the mean, since the zero of the sensor is arbitrary [um].
    percent
        Root mean square in % of the reference's range.
    note
        Origin of the row.
    """

    feedforward: str
    rms_um: float
    largest_um: float
    percent: float
    note: str

    def as_dict(self) -> dict[str, object]:
        """All fields, for `--json`."""
        return asdict(self)

    def text(self) -> str:
        """One line."""
        return _COLUMNS.format(
            self.feedforward, f"{self.rms_um:.3f}", f"{self.largest_um:.3f}", f"{self.percent:.2f}", self.note
        )


_COLUMNS = "{:<34} {:>8} {:>8} {:>6}  {}"


def header() -> str:
    """The header line."""
    return _COLUMNS.format("feedforward", "rms um", "max um", "rms %", "how")


def summary(rows: Sequence[FlexureRow]) -> str:
    """The summary line."""
    recorded, extended = rows[0], rows[-2]
    return (
        f"recorded feedforward error {recorded.rms_um:.3f} um rms; the extended inverse is predicted to leave "
        f"{extended.rms_um:.3f} um; no bench has been driven"
    )


def study(folder: Path) -> Iterator[FlexureRow]:
    """Rows: as recorded, static inverse, extended inverse, and whether the extended inverse can be driven."""
    tracking = read_csv(REAL / "tracking.csv")
    first, rest = (_part(tracking, keep) for keep in _split(tracking.time_s))
    write_csv(first, folder / "first.csv")
    write_csv(rest, folder / "rest.csv")
    run("identify", REAL / "identification.csv", "-o", folder / "alone.yaml", *COLUMNS)
    run("identify", REAL / "identification.csv", folder / "first.csv", "-o", folder / "model.yaml", *COLUMNS)
    run("diagnose", folder / "first.csv", "--model", folder / "model.yaml", "-o", folder / "out", *COLUMNS)
    findings = json.loads((folder / "out" / "findings.json").read_text(encoding="utf-8"))
    named = ", ".join(f"{one['name']} {one['confidence']:.2f}" for one in findings["effects"]) or "nothing"
    reference = rest.channel("reference_um")
    settled = rest.time_s > rest.time_s[0] + SETTLES_S
    yield _row("recorded by the author", rest.channel("displacement_um") - reference, reference, settled, "measured")
    extended = load_model(folder / "out" / "model.yaml")
    for title, model, note in (
        ("static inverse, predicted", load_model(folder / "alone.yaml"), "identification.csv alone"),
        ("static inverse, predicted", load_model(folder / "model.yaml"), "and the first part of tracking.csv"),
        ("extended inverse, predicted", extended, f"{findings['verdict']}: {named}"),
    ):
        simulated = simulate_recording(model, rest, START_WINDOW_S).recording.channel("displacement_um")
        yield _row(title, rest.channel("displacement_um") - simulated, reference, settled, note)
    yield _driven(extended, rest, reference, settled)


def _split(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return time_s < HELD_OUT_FROM_S, time_s >= HELD_OUT_FROM_S


def _part(recording: Recording, keep: np.ndarray) -> Recording:
    channels = {name: values[keep] for name, values in recording.channels.items()}
    return Recording(recording.time_s[keep], channels, recording.metadata, recording.source)


def _row(title: str, error_um: np.ndarray, reference_um: np.ndarray, settled: np.ndarray, note: str) -> FlexureRow:
    error_um = error_um[settled] - error_um[settled].mean()
    rms_um = float(np.sqrt(np.mean(error_um**2)))
    return FlexureRow(title, rms_um, float(np.abs(error_um).max()), 100.0 * rms_um / float(np.ptp(reference_um)), note)


def _driven(model: Model, rest: Recording, reference_um: np.ndarray, settled: np.ndarray) -> FlexureRow:
    """The extended inverse over the author's reference, its voltages within the recorded range, simulated."""
    without = [name for name in acting_effects(model) if EFFECTS[name].handling != "compensated"]
    compensator = ExtendedCompensator(model, rest.dt_s, without)
    wanted = reference_um + 0.5 * (model.output.low + model.output.high)
    planned = compensator.ahead(wanted, loop=False)
    voltage_V = np.empty(wanted.size)
    for k, value in enumerate(planned):
        voltage_V[k] = min(max(compensator.plan(float(value)), model.input.low), model.input.high)
        compensator.commit(voltage_V[k])
    driven = model.model_copy(update={"sampling": "held", "read_after": 1.0, "seen_s": model.seen_s})
    late = driven.model_copy(
        update={"effects": tuple(one for one in driven.effects if one.name not in (*without, "transport_delay"))}
    )
    output = run_chain(late, late.operator(), rest.time_s, voltage_V)
    inside = (voltage_V > model.input.low) & (voltage_V < model.input.high)
    note = (
        f"its own voltages simulated, {100 * np.mean(~inside):.0f} % at a limit; left out: {', '.join(without) or '-'}"
    )
    return _row("extended inverse, planned", output - planned, reference_um, settled & inside, note)
