"""`piezod check --proof`: drive a bench at low voltage through its trips, the watchdog of its device, and a stop.

Each step (`STEPS`) arms the bench with every precondition, drives `PROOF_SHARE` of the voltage range and provokes one
reaction: by a tightened limit, by a changed reading or by withheld exchanges, never by a higher voltage. A function
that the bench lacks is skipped with its reason, and counts as not proven where a trip is configured (`coverage.py`).

The bench is left at rest in any case, also after Ctrl-C. The record is written even when a step fails.
"""

import contextlib
import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from piezod.commissioning.proof import device_steps, reading_steps
from piezod.commissioning.proof.bench import ProofBench
from piezod.commissioning.proof.comparison import compare, earlier_records
from piezod.commissioning.proof.record import (
    ProofEnd,
    ProofStep,
    check_target,
    make_record,
    record_path,
    utc_now,
    write_record,
)
from piezod.commissioning.safe_stop import bring_to_rest
from piezod.config import BenchConfig
from piezod.control import real_time
from piezod.errors import PiezodError
from piezod.session.assembly import load_bench_without_model, opened_link
from piezod.session.lock import lock_bench
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
    lock = lock_bench(bench)
    try:
        with opened_link(bench) as link, warnings.catch_warnings(action="ignore"), real_time(bench.real_time):
            end = _run_steps(bench, link)
            record = make_record(bench, link, end, now, tuple(STEPS), tester)
    finally:
        lock.close()
    folder = target.parent if bench.proof is None else path.parent / (bench.proof.folder or "")
    record |= compare(record, earlier_records(bench, folder, now))
    write_record(record, target)
    return record, target


def _run_steps(bench: BenchConfig, link: Link) -> ProofEnd:
    """Do the steps until one cannot be done or Ctrl-C; after each, bring the bench to rest."""
    steps: list[ProofStep] = []
    with ProofBench(bench, link) as proof, _interruptible(proof):
        for name, step in STEPS.items():
            try:
                steps.append(step(proof))
            except PiezodError as error:
                steps.append(ProofStep(name, "fail", detail=str(error)))
            finally:
                failure = _rest(bench, link)
            if failure or proof.interrupted or (name == "level" and steps[-1].result == "fail"):
                break
    return ProofEnd(steps, failure, proof.interrupted)


def _rest(bench: BenchConfig, link: Link) -> str:
    """Bring the bench to rest; returns the failure, or an empty text."""
    try:
        bring_to_rest(bench, link)
    except PiezodError as error:
        return str(error)
    return ""


@contextlib.contextmanager
def _interruptible(proof: ProofBench) -> Iterator[None]:
    """Let SIGINT and SIGTERM request a ramp down in place of an exception in the middle of an exchange."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: proof.interrupt()) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


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
