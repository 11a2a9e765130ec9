"""Iterative learning on concealed plants, which share no physics with the emulated bench and none with the model.

The model is identified on the plant's identification record. The voltages of all repeats so far drive the plant from
rest, so its memory is right. Each line has the error of every repeat over the noise, root mean square.
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from firmware_sim.concealed.study.case import Record
from firmware_sim.concealed.study.drawing import CaseSpec, draw_case
from firmware_sim.concealed.study.families import FAMILIES
from firmware_sim.concealed.study.make import write_record
from piezod.blind.case import Description
from piezod.blind.diagnose_case import identified
from piezod.control.references.iterative_learning import Bounds, IterativeLearning
from piezod.model import make_compensator

EFFECTS = (
    "",
    "creep",
    "friction",
    "electrical_lag",
    "noncongruent_minor_loops",
    "output_nonlinearity",
    "resonance",
    "transport_delay",
    "contact_gap",
    "rate_dependent_hysteresis",
)
STRENGTH = 20.0  # noises
LOWEST, SPAN = 0.3, 0.4  # of the range of the forces, for the triangle of 1 Hz
MOST_PART = 0.25  # as the daemon bounds a correction


def errors(effect: str, family: str, seed: int, repeats: int) -> tuple[list[float], float, str]:
    """Error of every repeat over the noise, sample rate [Hz], and the state of the learning."""
    names = (effect,) if effect else ()
    spec = CaseSpec("single" if effect else "null", names, (STRENGTH,) * len(names), "white", family)
    case = draw_case(spec, np.random.SeedSequence(seed))
    work = next(record for record in case.records if record.name.startswith("recording"))
    rate_Hz = work.drive.rate_Hz
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_record(place / "identification.csv", case, case.records[0])
        said = Description("identification.csv", ("-",), "identification.csv", "voltage_V", "force_N")
        model = identified(said, place)
    ticks, low, high = int(rate_Hz), model.output.low, model.output.high
    phase = np.arange(ticks) / ticks
    reference = low + (high - low) * (LOWEST + SPAN * (1.0 - np.abs(2.0 * phase - 1.0)))
    learning = IterativeLearning(reference, reference, rate_Hz, Bounds(MOST_PART * float(np.ptp(reference))))
    compensator = make_compensator("inverse", model, 1.0 / rate_Hz)
    voltage_V: list[float] = []

    def drive(force_N: np.ndarray) -> np.ndarray:
        cut = np.zeros(force_N.size, dtype=bool)
        for k, force in enumerate(force_N):
            planned = compensator.plan(float(force))
            written = float(np.clip(planned, model.input.low, model.input.high))
            compensator.commit(written)
            voltage_V.append(written)
            cut[k] = written != planned
        return cut

    drive(np.linspace(low, reference[0], ticks))
    correction, found = np.zeros(ticks), []
    for _ in range(repeats):
        limited = drive(reference + correction)
        driven = np.round(np.array(voltage_V), 4)
        warmth = np.full(driven.size, work.drive.temperature_C[0])
        record = Record("recording_2.csv", replace(work.drive, voltage_V=driven, temperature_C=warmth), work.seed + 5)
        wanted = learning.add(case.reading_N(record)[-ticks:], correction, limited)
        found.append(learning.errors_N[-1] / case.noise.rms_N)
        correction = correction if wanted is None else wanted
    return found, rate_Hz, learning.state.value


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--only", metavar="EFFECT,...", help=f"of {', '.join(EFFECTS[1:])}; default: all, and none")
    parser.add_argument("--repeats", type=int, default=9, metavar="N", help="repeats, %(default)s")
    parser.add_argument("--seed", type=int, default=11, metavar="S", help="seed of the plants, %(default)s")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, _: argparse.ArgumentParser) -> None:
    for effect in options.only.split(",") if options.only else EFFECTS:
        for number, family in enumerate(FAMILIES):
            found, rate_Hz, state = errors(effect, family, options.seed + number, options.repeats)
            repeats = " ".join(f"{one:7.2f}" for one in found)
            print(f"{effect or 'none':26} {family:12} {rate_Hz:6.0f} Hz {repeats}  {state}", flush=True)
