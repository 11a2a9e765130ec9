"""Steps of the proof test about exchanges, ticks, the status of the device, its watchdog and a stop."""

from piezod.commissioning.proof.bench import HOLD_S, ProofBench
from piezod.commissioning.proof.links import Change, Changes, with_bits, without_bits
from piezod.commissioning.proof.record import ProofStep, skipped, word
from piezod.control import Cause
from piezod.transport import ExchangeResult
from piezod.transport.status import STATUS_AMPLIFIER_FAULT, STATUS_CLAMPED, STATUS_OUTPUT_ON

SETTLE_S = 0.1  # of the last millivolts, beyond the time of a ramp
FAILED = 5  # most failed exchanges that the step counts
MISSED = 5  # most missed ticks that the step provokes
CLAMPED_MS = 200.0  # longest proven duration of a clamped output
TICKS_OF_WATCHDOG = 4  # late ticks come at half the rate, with a margin of as much


def prove_stale(proof: ProofBench) -> ProofStep:
    """Replies without a new sample: the trip of readings that are stale."""
    limits = proof.bench.limits
    changes = Changes(result=ExchangeResult.HEARTBEAT_STOOD)
    run = proof.hold_level(changes=changes, lasts_s=max(HOLD_S, 4e-3 * limits.stale_after_ms))
    limit_ms = limits.stale_after_ms + proof.reaction_ms(2)
    wrong = run.since_level & (run.rows["result"] == ExchangeResult.HEARTBEAT_STOOD)
    return run.step("stale", wrong, limit_ms, None, Cause.BAD_READING, Cause.COMM_LOSS)


def prove_silence(proof: ProofBench) -> ProofStep:
    """Exchanges withheld until the trip of a communication loss."""
    limits = proof.bench.limits
    run = proof.hold_level(changes=Changes(silent=True), lasts_s=max(HOLD_S, 4e-3 * limits.comm_loss_ms))
    limit_ms = limits.comm_loss_ms + proof.reaction_ms(1)
    wrong = run.since_level & (run.rows["result"] == ExchangeResult.TIMEOUT)
    return run.step("silence", wrong, limit_ms, None, Cause.COMM_LOSS)


def prove_exchanges(proof: ProofBench) -> ProofStep:
    """The count of failed exchanges: every second reply is without a new sample."""
    most = min(proof.bench.limits.failed_exchanges or FAILED, FAILED)
    result = ExchangeResult.HEARTBEAT_STOOD
    changes = Changes(result=result, now=lambda: proof.in_odd_tick)
    run = proof.hold_level(tightened={"failed_exchanges": most}, changes=changes)
    failed = run.since_level & (run.rows["result"] == result)
    limit_ms = proof.reaction_ms(3 * most)  # a failure adds 3 to the count, a good exchange takes 1 away
    return run.step("exchanges", failed, limit_ms, (float(failed.sum()), most, "failed"), Cause.BAD_EXCHANGES)


def prove_missed(proof: ProofBench) -> ProofStep:
    """The trip of missed ticks: each tick at the level ends after its deadline."""
    limits, tick_ms = proof.bench.limits, 1e3 * proof.bench.dt_s
    if not proof.has_deadlines:
        return skipped("missed", "the device runs in virtual time, which waits for every tick")
    least_ms = TICKS_OF_WATCHDOG * tick_ms
    for key, value in (("device_watchdog_ms", limits.device_watchdog_ms), ("comm_loss_ms", limits.comm_loss_ms)):
        if 0 < value < least_ms:
            return skipped("missed", f"limits.{key} is {value:g}, below {least_ms:g}: late ticks would trip it before")
    most = min(limits.missed_ticks_in_a_row, MISSED)
    run = proof.hold_level(tightened={"missed_ticks_in_a_row": most}, late=True)
    missed = run.since_level & run.skipped_ticks
    limit_ms = 2.0 * proof.reaction_ms(most)
    return run.step("missed", missed, limit_ms, (float(missed.sum()), most, "ticks"), Cause.MISSED_TICKS)


def prove_output(proof: ProofBench) -> ProofStep:
    """The trip of an output that the device reports as off."""
    if not proof.bench.limits.output_on_in_status:
        return skipped("output", "limits.output_on_in_status is false")
    return _status_step(proof, "output", without_bits(STATUS_OUTPUT_ON), Cause.OUTPUT_OFF, 1e3 * proof.bench.dt_s)


def prove_clamp(proof: ProofBench) -> ProofStep:
    """The trip of an output that the device reports as clamped."""
    configured_ms = proof.bench.limits.clamped_trip_ms
    if configured_ms is None:
        return skipped("clamp", "limits.clamped_trip_ms is null")
    trip_ms = min(configured_ms, CLAMPED_MS)
    tightened = {"clamped_trip_ms": trip_ms}
    return _status_step(proof, "clamp", with_bits(STATUS_CLAMPED), Cause.CLAMPED, trip_ms, tightened)


def prove_amplifier(proof: ProofBench) -> ProofStep:
    """The trip of a fault that the amplifier reports."""
    return _status_step(proof, "amplifier", with_bits(STATUS_AMPLIFIER_FAULT), Cause.DEVICE_FAULT, 0.0)


def _status_step(
    proof: ProofBench,
    name: str,
    change: Change,
    cause: Cause,
    after_ms: float,
    tightened: dict[str, float] | None = None,
) -> ProofStep:
    """A changed status at the level, which must trip with `cause` within `after_ms` and the ticks to react."""
    if not proof.bench.has_role("status"):
        return skipped(name, "the bench reads no status")
    run = proof.hold_level(tightened=tightened, changes=Changes({"status": change}))
    limit_ms = after_ms + proof.reaction_ms(1)
    return run.step(name, run.since_level, limit_ms, None, cause)


def prove_watchdog(proof: ProofBench) -> ProofStep:
    """The watchdog of the device: without commands it must bring the output to rest."""
    limits = proof.bench.limits
    if limits.device_watchdog_ms == 0:
        return skipped("watchdog", "limits.device_watchdog_ms is 0: the output stays up when this machine fails")
    if not proof.bench.has_role("voltage_readback"):
        return ProofStep("watchdog", "fail", detail="without voltage read-back the output cannot be seen")
    begun_ms, left_V, rest_ms = proof.withhold_commands()
    within_V = proof.bench.arming.readback_within_V
    right = begun_ms <= proof.watchdog_limit_ms and left_V <= within_V
    detail = f"output falls after {begun_ms:.1f} ms, limit {proof.watchdog_limit_ms:.1f} ms; at rest after the time"
    return ProofStep("watchdog", word(right), left_V, within_V, "V", rest_ms, detail)


def prove_stop(proof: ProofBench) -> ProofStep:
    """A stop at the level: the ramp down at its rate, then rest."""
    run = proof.hold_level(stops=True)
    limits = proof.bench.limits
    limit_ms = 1e3 * (abs(proof.level_V - limits.voltage_safe_V) / limits.ramp_down_V_per_s + SETTLE_S)
    limit_ms += limits.readback_trip_ms
    time_ms = run.time_of_ramp_ms()
    left_V, within_V = abs(run.left_V - limits.voltage_safe_V), proof.bench.arming.readback_within_V
    right = run.fault is Cause.NONE and time_ms <= limit_ms and not left_V > within_V
    return ProofStep("stop", word(right), left_V, within_V, "V", time_ms, run.outcome(limit_ms))
