"""Diagnoses of measured recordings of other machines, beside the simulation of the models that they deliver.

    python -m tests.studies real_recordings --json real.json

A model is identified on one recording of a machine, and a second one of it is diagnosed. The error of the given and of
the delivered model is what `piezod simulate` leaves, on the diagnosed recording and on a third one. Most of these
machines are no piezo benches, and no effect of the catalogue is known to act in them. Cascaded tanks and servo axis are
split into estimation and test as by nonlinearbenchmark.org; of the Silverbox only two stretches of its multisine exist.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

from piezod.diagnose.command import diagnose_files
from piezod.errors import PiezodError
from piezod.estimation.recordings.intake import load_recordings
from piezod.identify.identification import identify
from piezod.identify.options import Options
from piezod.model import load_model, save_model
from tests.studies.contradictions import Result, contradictions, simulated_rms
from tests.studies.scenarios import ROOT

REAL = ROOT.parent / "shared" / "recordings"


@dataclass(frozen=True)
class Pair:
    """Recordings of one machine.

    Parameters
    ----------
    machine
        Folder.
    identification, work
        Files without their suffix.
    input, output
        Columns.
    held_out
        Another file of the machine; empty: none.
    """

    machine: str
    identification: str
    work: str
    input: str
    output: str
    held_out: str = ""


PAIRS = (
    Pair("piezo-flexure", "identification", "tracking", "voltage_V", "displacement_um"),
    Pair("piezo-flexure", "tracking", "identification", "voltage_V", "displacement_um"),
    Pair("pneumatic-friction", "circle_3bar", "kidney_3bar", "displacement_mm", "force_N", "circle_5bar"),
    Pair("pneumatic-friction", "kidney_3bar", "circle_3bar", "displacement_mm", "force_N", "circle_5bar"),
    Pair("friction-damper", "1Hz30lbtension1amplitude", "2Hz30lbtension0p5amplitude", "displacement_in", "force_kip"),
    Pair("friction-damper", "1Hz30lbtension1amplitude", "2Hz0lbtension1amplitude", "displacement_in", "force_kip"),
    Pair("servo-axis", "bang-bang", "pulses", "reference_mm", "position_mm"),
    Pair("servo-axis", "bang-bang", "pulses", "position_mm", "force_N"),
    Pair("silverbox", "first", "second", "voltage_V", "sensor_V"),
    Pair("silverbox", "first", "first", "voltage_V", "sensor_V", "second"),
    Pair("servo-axis", "bang-bang", "bang-bang", "motor_V", "position_mm", "pulses"),
    Pair("cascaded-tanks", "tanks_id", "tanks_work", "voltage_V", "sensor_V", "tanks_hold"),
    Pair("mr-damper", "0V88", "1V98", "displacement_mm", "force_N"),
    Pair("mr-damper", "0V", "0V88", "displacement_mm", "force_N"),
    Pair("steering-mirror", "100mV", "300mV", "u3_V", "y1_um"),
    Pair("steering-mirror", "100mV", "300mV", "u1_V", "y1_um"),
)


@dataclass
class RealRow:
    """Diagnosis of one pair.

    Parameters
    ----------
    pair
        Machine, identification and work.
    verdict
        Of the findings; "refused" with the error in `notes`.
    named
        Effects with confidence and intervals.
    given, delivered
        Errors of both models on the work, as simulated [output unit].
    held_out
        The same on the third recording.
    floor, floor_from
        Noise as told [output unit], and its origin.
    cpu_s
        Processor time of the diagnosis [s].
    contradicted
        Sentences that simulation contradicts.
    notes
        Notes of the diagnosis.
    """

    pair: str
    verdict: str
    named: tuple[str, ...] = ()
    given: float = 0.0
    delivered: float = 0.0
    held_out: tuple[float, float] | None = None
    floor: float | None = None
    floor_from: str = ""
    cpu_s: float = 0.0
    contradicted: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """The lines of the table."""
        floor = "unknown" if self.floor is None else f"{self.floor:.3g}"
        head = f"{self.pair}: {self.verdict}, {self.given:.4g} -> {self.delivered:.4g}"
        if self.held_out is not None:
            head += f", held out {self.held_out[0]:.4g} -> {self.held_out[1]:.4g}"
        lines = [f"{head}, noise {floor} ({self.floor_from}), {self.cpu_s:.0f} s"]
        lines += [f"    {one}" for one in self.named]
        lines += [f"    CONTRADICTED: {one}" for one in self.contradicted]
        lines += [f"    note: {one}" for one in self.notes]
        return "\n".join(lines)


def run(pair: Pair) -> RealRow:
    """Identify, diagnose, simulate."""
    folder = REAL / pair.machine
    name = f"{pair.machine} {pair.identification} -> {pair.work} ({pair.input}, {pair.output})"
    work = folder / f"{pair.work}.csv"
    held_out = (folder / f"{pair.held_out}.csv",) if pair.held_out else ()
    begun_s = time.process_time()
    with tempfile.TemporaryDirectory() as temporary:
        given, output = Path(temporary) / "model.yaml", Path(temporary) / "out"
        try:
            (loaded,) = load_recordings([folder / f"{pair.identification}.csv"], pair.input, pair.output)
            options = Options(input=pair.input, output=pair.output)
            found = identify([loaded.recording], options, "", sources=[loaded.source], notes=loaded.notes)
            save_model(found.model, given)
            begun_s = time.process_time()
            diagnose_files([work], given, output, None, None, lambda *_: None)
        except PiezodError as error:
            return RealRow(name, "refused", notes=(str(error),), cpu_s=time.process_time() - begun_s)
        cpu_s = time.process_time() - begun_s
        result = Result(given, output, (work,), held_out)
        findings = result.findings
        models = [load_model(path) for path in (given, result.written)]
        errors = [simulated_rms(model, [work]) for model in models]
        others = [simulated_rms(model, held_out) for model in models] if held_out else None
        return RealRow(
            name,
            findings["verdict"],
            tuple(_said(one) for one in findings["effects"]),
            errors[0],
            errors[1],
            None if others is None else (others[0], others[1]),
            findings["noise_floor"]["value"],
            findings["noise_floor"]["from"] or "",
            cpu_s,
            tuple(contradictions(result)),
            tuple(findings["notes"]),
        )


def _said(effect: dict) -> str:
    values = [
        f"{name} {one['value']:.3g} ({one['low']:.3g} to {one['high']:.3g}) {one['unit']}"
        for name, one in effect["parameters"].items()
    ]
    return f"{effect['name']}, confidence {effect['confidence']:.2f}: {', '.join(values)}"


def summary(rows: Sequence[RealRow]) -> str:
    """Counts."""
    verdicts = {verdict: sum(row.verdict == verdict for row in rows) for verdict in sorted({r.verdict for r in rows})}
    counted = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.items())
    worse = sum(row.delivered > 1.02 * row.given for row in rows)
    told = sum(len(row.contradicted) for row in rows)
    return f"{len(rows)} diagnoses: {counted}; {worse} made worse; {told} sentences contradicted by simulation"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--only", metavar="MACHINE,...", help="folders of recordings; default: all")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="number of parallel diagnoses")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    if not REAL.is_dir():
        parser.error(f"{REAL} does not exist: the real recordings are not part of the project")
    machines = options.only.split(",") if options.only else [pair.machine for pair in PAIRS]
    pairs = [pair for pair in PAIRS if pair.machine in machines]
    rows = []
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        for row in pool.map(run, pairs):
            rows.append(row)
            print(row.text(), flush=True)
    print(summary(rows))
    if options.json:
        options.json.write_text(json.dumps([asdict(row) for row in rows], indent=1) + "\n", encoding="utf-8")
