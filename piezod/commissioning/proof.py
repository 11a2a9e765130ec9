"""`piezod check --proof`: drive a bench at low voltage through its trips, the watchdog of the device, and a stop.

Each step arms the bench with every precondition, drives `PROOF_SHARE` of the voltage range and provokes one reaction:

    level       the force rises, and the voltage read back is the voltage written.
    force       the force trip lies between the forces at rest and at this level.
    minimum     the least force lies between the forces at rest and at this level.
    readback    the voltage read back is shifted before it is checked.
    watchdog    the commands are withheld; the device must bring its output to rest by itself.
    stop        a stop is requested.

The bench is left at rest in any case, also after Ctrl-C. The record is written even when a step fails.
"""

import contextlib
import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from piezod.commissioning.proof_bench import ProofBench, ShiftedReadback
from piezod.commissioning.proof_record import ProofEnd, ProofStep, make_record, record_path, utc_now, write_record
from piezod.commissioning.safe_stop import bring_to_rest
from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, real_time
from piezod.errors import PiezodError
from piezod.session.assembly import load_bench_without_model, opened_link
from piezod.session.lock import lock_bench
from piezod.transport import Link

TICKS_TO_REACT = 2.5  # from a debounce's last sample to the command that it changes, two; half a tick is jitter
SETTLE_S = 0.1  # of the last millivolts, beyond the time of a ramp


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
                left = _rest(bench, link)
            if left or proof.interrupted or (name == "level" and steps[-1].result == "fail"):
                break
    return ProofEnd(steps, left, proof.interrupted)


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


def _level(proof: ProofBench) -> ProofStep:
    """Force at rest and at the level of the test, and the error of the voltage read back."""
    rest_N = proof.read_force_N()
    run = proof.hold_level()
    if run.fault is not Cause.NONE:
        return ProofStep("level", "fail", detail=CAUSE_TEXT[run.fault])
    proof.rest_N, proof.level_N = rest_N, run.force_N
    rise_N, least_N = run.force_N - rest_N, proof.bench.arming.sign_check.rise_N
    right = rise_N >= least_N and not run.readback_error_V > proof.readback_limit_V  # nan: no readback
    detail = f"{proof.level_V:.2f} V, read back {run.readback_V:.2f} V; the force must rise by at least the limit"
    return ProofStep("level", "pass" if right else "fail", rise_N, least_N, "N", None, detail)


def _force(proof: ProofBench) -> ProofStep:
    """The force trip, set between the forces at rest and at the level."""
    trip_N = min(0.5 * (proof.rest_N + proof.level_N), proof.bench.limits.force_trip_N)
    run = proof.hold_level(tightened={"force_trip_N": trip_N})
    samples = proof.bench.limits.force_debounce_samples + TICKS_TO_REACT
    limit_ms = 1e3 * samples * proof.bench.dt_s
    time_ms = run.time_to_fault_ms(run.rows["force_N"] > trip_N)
    right = run.fault is Cause.OVER_FORCE and time_ms <= limit_ms
    return ProofStep("force", _word(right), run.highest_N, trip_N, "N", time_ms, run.outcome(limit_ms))


def _minimum(proof: ProofBench) -> ProofStep:
    """The least force, set between the forces at rest and at the level: the force is below it from the begin."""
    least_N = max(0.5 * (proof.rest_N + proof.level_N), proof.bench.limits.force_min_N)
    run = proof.hold_level(tightened={"force_min_N": least_N})
    limit_ms = 1e3 * (proof.bench.limits.force_debounce_samples + TICKS_TO_REACT) * proof.bench.dt_s
    time_ms = run.time_to_fault_ms(run.rows["force_N"] < least_N)
    right = run.fault is Cause.UNDER_FORCE and time_ms <= limit_ms
    return ProofStep("minimum", _word(right), run.lowest_N, least_N, "N", time_ms, run.outcome(limit_ms))


def _readback(proof: ProofBench) -> ProofStep:
    """The readback trip, by a reading that is shifted by twice its limit."""
    limits = proof.bench.limits
    if limits.readback_trip_V is None or not proof.bench.has_role("voltage_readback"):
        return ProofStep("readback", "skipped", detail="the bench has no voltage read-back, or readback_trip_V is null")
    shift_V = 2.0 * limits.readback_trip_V
    run = proof.hold_level(link=ShiftedReadback(proof.link, shift_V, proof.level_reached))
    limit_ms = 2.0 * limits.readback_trip_ms + 1e3 * TICKS_TO_REACT * proof.bench.dt_s
    time_ms = run.time_to_fault_ms(abs(run.rows["readback_V"] - run.rows["voltage_V"]) > limits.readback_trip_V)
    right = run.fault is Cause.READBACK and time_ms <= limit_ms
    return ProofStep("readback", _word(right), shift_V, limits.readback_trip_V, "V", time_ms, run.outcome(limit_ms))


def _watchdog(proof: ProofBench) -> ProofStep:
    """The watchdog of the device: without commands it must bring the output to rest."""
    limits = proof.bench.limits
    if limits.device_watchdog_ms == 0:
        detail = "limits.device_watchdog_ms is 0: the output stays up when this machine fails"
        return ProofStep("watchdog", "skipped", detail=detail)
    if not proof.bench.has_role("voltage_readback"):
        return ProofStep("watchdog", "fail", detail="without voltage read-back the output cannot be seen")
    begun_ms, left_V, rest_ms = proof.withhold_commands()
    within_V = proof.bench.arming.readback_within_V
    right = begun_ms <= proof.watchdog_limit_ms and left_V <= within_V
    detail = f"output falls after {begun_ms:.1f} ms, limit {proof.watchdog_limit_ms:.1f} ms; at rest after the time"
    return ProofStep("watchdog", _word(right), left_V, within_V, "V", rest_ms, detail)


def _stop(proof: ProofBench) -> ProofStep:
    """A stop at the level: the ramp down at its rate, then rest."""
    run = proof.hold_level(stops=True)
    limits = proof.bench.limits
    limit_ms = 1e3 * (abs(proof.level_V - limits.voltage_safe_V) / limits.ramp_down_V_per_s + SETTLE_S)
    limit_ms += limits.readback_trip_ms
    time_ms = run.time_of_ramp_ms()
    left_V, within_V = abs(run.left_V - limits.voltage_safe_V), proof.bench.arming.readback_within_V
    right = run.fault is Cause.NONE and time_ms <= limit_ms and not left_V > within_V
    return ProofStep("stop", _word(right), left_V, within_V, "V", time_ms, run.outcome(limit_ms))


def _word(right: bool) -> Any:  # noqa: ANN401  # one of the literals of ProofStep
    return "pass" if right else "fail"


STEPS: dict[str, Callable[[ProofBench], ProofStep]] = {
    "level": _level,
    "force": _force,
    "minimum": _minimum,
    "readback": _readback,
    "watchdog": _watchdog,
    "stop": _stop,
}
"""The steps of a complete test, in their order; the first measures what the others need."""
