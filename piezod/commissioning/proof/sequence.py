"""`piezod check --proof`: drive a bench at low voltage through its trips, the watchdog of its device, and a stop.

Each step (`STEPS`) arms the bench with every precondition, drives `PROOF_SHARE` of the voltage range and provokes one
reaction: by a tightened limit, by a changed reading or by withheld exchanges, never by a higher voltage. A function
that the bench lacks is skipped with its reason, and counts as not proven where a trip is configured (`coverage.py`).

The test is driven by a service, as all that drives: `piezod stop` and `piezod status` work on it. The bench is left at
rest in any case, also after Ctrl-C. The record is written even when a step fails.
"""

import json
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

from piezod.commissioning.proof import device_steps, reading_steps
from piezod.commissioning.proof.bench import ProofBench
from piezod.commissioning.proof.comparison import compare
from piezod.commissioning.proof.record import (
    ProofEnd,
    ProofStep,
    check_target,
    make_record,
    record_path,
    utc_now,
)
from piezod.commissioning.safe_stop import bring_to_rest
from piezod.config import BenchConfig
from piezod.control import ControlLoop, RateKeeper
from piezod.daemon.proof_date import proof_records
from piezod.daemon.run import drive, rows_are_saved
from piezod.errors import CheckFailedError, PiezodError
from piezod.runtime.files import written
from piezod.session.assembly import load_bench_without_model
from piezod.transport import Link


def prove(path: Path, output: Path | None = None, tester: str = "") -> tuple[dict[str, Any], Path]:
    """Run the proof test and write its record.

    Parameters
    ----------
    path
        Bench configuration.
    output
        Record to write; None: NAME-proof-DATE.json in the present folder.
    tester
        Name of the person who tests; empty: the user of this process.

    Returns
    -------
    tuple
        The record and its path.

    Raises
    ------
    BusyError
        A daemon drives or watches the bench.
    UsageError
        The record exists already.
    ConfigurationError, TemporaryError
        The bench file is invalid, the device is another one, or it does not answer.
    """
    if output is not None:
        check_target(output)
    bench = load_bench_without_model(path)
    now = utc_now()
    target = record_path(bench, output, now)
    _, outcome = drive(path, bench, None, [], lambda _: None, ProofTest(now, tester))
    record: dict[str, Any] | None = outcome.returned
    if record is None:
        raise CheckFailedError(f"{path}: {outcome.fault or 'stopped before the proof test began'}; no record")
    folder = target.parent if bench.proof is None else path.parent / (bench.proof.folder or "")
    record |= compare(record, proof_records(folder, bench.name))
    written(target, json.dumps(record, indent=2) + "\n")
    rows_are_saved()
    return record, target


class ProofTest:
    """The proof test in the control process (`session.task.Program`); its result is the record.

    Parameters
    ----------
    now
        Time of the begin, UTC.
    tester
        Name of the person who tests; empty: the user of this process.
    """

    def __init__(self, now: datetime, tester: str) -> None:
        self._now, self._tester = now, tester

    def prepare(self, bench: BenchConfig, link: Link, clock: RateKeeper) -> Link:
        """Link whose readings a step can change."""
        self._bench, self._link, self._proof = bench, link, ProofBench(bench, link, clock)
        return self._proof.link

    def run(self, loop: ControlLoop) -> dict[str, Any]:
        """Do the steps until one cannot be done or a stop comes; after each, bring the bench to rest."""
        proof, steps = self._proof, list[ProofStep]()
        proof.begin(loop)
        for name, step in STEPS.items():
            try:
                steps.append(step(proof))
            except PiezodError as error:
                steps.append(ProofStep(name, "fail", detail=str(error)))
            finally:
                failure = _rest(self._bench, self._link)
            if failure or proof.interrupted or (name == "level" and steps[-1].result == "fail"):
                break
        end = ProofEnd(steps, failure, proof.interrupted)
        return make_record(self._bench, self._link, end, self._now, tuple(STEPS), self._tester)


def _rest(bench: BenchConfig, link: Link) -> str:
    """Bring the bench to rest; returns the failure, or an empty text."""
    try:
        bring_to_rest(bench, link)
    except PiezodError as error:
        return str(error)
    return ""


STEPS: dict[str, Callable[[ProofBench], ProofStep]] = {
    "level": reading_steps.prove_level,
    "force": reading_steps.prove_force,
    "minimum": reading_steps.prove_minimum,
    "rate": reading_steps.prove_rate,
    "tracking": reading_steps.prove_tracking,
    "stuck": reading_steps.prove_stuck,
    "readback": reading_steps.prove_readback,
    "heat": reading_steps.prove_heat,
    "temperature": reading_steps.prove_temperature,
    "thermometer": reading_steps.prove_thermometer,
    "stale": device_steps.prove_stale,
    "silence": device_steps.prove_silence,
    "exchanges": device_steps.prove_exchanges,
    "missed": device_steps.prove_missed,
    "output": device_steps.prove_output,
    "clamp": device_steps.prove_clamp,
    "amplifier": device_steps.prove_amplifier,
    "watchdog": device_steps.prove_watchdog,
    "stop": device_steps.prove_stop,
}
"""The steps of a complete test, in their order; the first measures values for the others."""
