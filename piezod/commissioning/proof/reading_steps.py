"""Steps of the proof test about readings: force, voltage read back, heat and temperature."""

from math import isfinite, pi, sqrt

import numpy as np

from piezod.commissioning.proof.bench import ProofBench, Run
from piezod.commissioning.proof.links import Changes, frozen, shifted
from piezod.commissioning.proof.record import ProofStep, skipped, word
from piezod.control import CAUSE_TEXT, Cause
from piezod.control.interlocks import STRANGE_SAMPLES

TRACKING_MS = 200.0  # longest proven duration of a tracking error; the hold is not much longer
LEAST_OVER_S = 1.0  # a mean over less time forgets the heat of the approach
STEP_DEGC = 1.0  # distance of a tightened limit from the present temperature


def prove_level(proof: ProofBench) -> ProofStep:
    """Force at rest and at the level of the test, and the error of the voltage read back."""
    rest_N = proof.read_force_N()
    run = proof.hold_level()
    if run.fault is not Cause.NONE:
        return ProofStep("level", "fail", detail=CAUSE_TEXT[run.fault])
    proof.rest_N, proof.level_N = rest_N, run.force_N
    rise_N, least_N = run.force_N - rest_N, proof.bench.arming.sign_check.rise_N
    right = rise_N >= least_N and not run.readback_error_V > proof.readback_limit_V  # nan: no readback
    detail = f"{proof.level_V:.2f} V, read back {run.readback_V:.2f} V; the force must rise by at least the limit"
    return ProofStep("level", word(right), rise_N, least_N, "N", None, detail)


def prove_force(proof: ProofBench) -> ProofStep:
    """The force trip, set between the forces at rest and at the level."""
    trip_N = min(0.5 * (proof.rest_N + proof.level_N), proof.bench.limits.force_trip_N)
    run = proof.hold_level(tightened={"force_trip_N": trip_N})
    limit_ms = proof.reaction_ms(proof.bench.limits.force_debounce_samples)
    wrong = run.rows["force_N"] > trip_N
    return run.step("force", wrong, limit_ms, (run.highest_N, trip_N, "N"), Cause.OVER_FORCE)


def prove_minimum(proof: ProofBench) -> ProofStep:
    """The least force, set between the forces at rest and at the level: the force is below it from the begin."""
    least_N = max(0.5 * (proof.rest_N + proof.level_N), proof.bench.limits.force_min_N)
    run = proof.hold_level(tightened={"force_min_N": least_N})
    limit_ms = proof.reaction_ms(proof.bench.limits.force_debounce_samples)
    wrong = run.rows["force_N"] < least_N
    return run.step("minimum", wrong, limit_ms, (run.lowest_N, least_N, "N"), Cause.UNDER_FORCE)


def prove_rate(proof: ProofBench) -> ProofStep:
    """The force rate, by a reading that jumps by half the distance to the force trip, like a broken cell."""
    limits = proof.bench.limits
    if limits.force_rate_trip_N_per_s is None:
        return skipped("rate", "limits.force_rate_trip_N_per_s is null")
    jump_N = 0.5 * (limits.force_trip_N - proof.level_N)
    samples = limits.force_debounce_samples
    # the jump lasts: it must still be too fast for the time since the last right sample at the end of the debounce
    rate = min(limits.force_rate_trip_N_per_s, 0.5 * jump_N / ((samples + 1) * proof.bench.dt_s))
    changes = Changes({"force_N": shifted(jump_N)})
    run = proof.hold_level(tightened={"force_rate_trip_N_per_s": rate}, changes=changes)
    limit_ms = proof.reaction_ms(samples)
    measured = jump_N / proof.bench.dt_s
    wrong = run.since_level & (run.rows["force_N"] > proof.level_N + 0.5 * jump_N)
    return run.step("rate", wrong, limit_ms, (measured, rate, "N/s"), Cause.FORCE_RATE)


def prove_tracking(proof: ProofBench) -> ProofStep:
    """The tracking trip: the expected force at the level exceeds the real force."""
    limits = proof.bench.limits
    if limits.tracking_trip_N is None:
        return skipped("tracking", "limits.tracking_trip_N is null")
    rise_N = proof.level_N - proof.rest_N
    trip_N = min(limits.tracking_trip_N, 0.5 * rise_N)
    trip_ms = min(limits.tracking_trip_ms, TRACKING_MS)
    expected_N = proof.level_N + 2.0 * trip_N
    tightened = {"tracking_trip_N": trip_N, "tracking_trip_ms": trip_ms}
    run = proof.hold_level(tightened=tightened, expected_N=expected_N)
    limit_ms = trip_ms + proof.reaction_ms(1)
    error_N = expected_N - run.force_N
    wrong = run.reached & (run.rows["force_N"] < expected_N - trip_N)
    return run.step("tracking", wrong, limit_ms, (error_N, trip_N, "N"), Cause.TRACKING)


def prove_stuck(proof: ProofBench) -> ProofStep:
    """The stuck cell, by a reading that stands still while the voltage falls."""
    limits, level_V = proof.bench.limits, proof.level_V
    if limits.stuck_samples is None:
        return skipped("stuck", "limits.stuck_samples is null")
    travel_V = min(limits.stuck_travel_V, 0.4 * (level_V - limits.voltage_safe_V))
    samples = min(limits.stuck_samples, proof.ticks_of_hold // 4)
    tightened = {"stuck_travel_V": travel_V, "stuck_samples": samples}
    run = proof.hold_level(tightened=tightened, changes=Changes({"force_N": frozen()}), falls=True)
    limit_ms = proof.reaction_ms(1)
    moved_V = level_V - run.rows["voltage_V"]
    at_trip_V = float(moved_V[np.argmax(run.tripped)]) if run.tripped.any() else float("nan")
    wrong = run.since_level & (moved_V >= travel_V)
    return run.step("stuck", wrong, limit_ms, (at_trip_V, travel_V, "V"), Cause.SENSOR_STUCK)


def prove_readback(proof: ProofBench) -> ProofStep:
    """The readback trip, by a reading that is shifted by twice its limit."""
    limits = proof.bench.limits
    if limits.readback_trip_V is None or not proof.bench.has_role("voltage_readback"):
        return skipped("readback", "the bench has no voltage read-back, or limits.readback_trip_V is null")
    shift_V = 2.0 * limits.readback_trip_V
    run = proof.hold_level(changes=Changes({"voltage_readback_V": shifted(shift_V)}))
    limit_ms = 2.0 * limits.readback_trip_ms + proof.reaction_ms(0)
    deviating = abs(run.rows["readback_V"] - run.rows["voltage_V"]) > limits.readback_trip_V
    wrong = run.since_level & deviating
    return run.step("readback", wrong, limit_ms, (shift_V, limits.readback_trip_V, "V"), Cause.READBACK)


def prove_heat(proof: ProofBench) -> ProofStep:
    """The heat, with a limit of half the power that the rise to the level adds to the mean."""
    limits = proof.bench.limits
    if limits.dissipation_max_W is None or limits.loss_tangent is None:
        return skipped("heat", "limits.dissipation_max_W is null")
    if limits.dissipation_over_s < LEAST_OVER_S:
        return skipped("heat", f"limits.dissipation_over_s is below {LEAST_OVER_S:g} s: the level adds no lasting heat")
    # a rise by s loses pi C tan(delta) s^2 / 2 (HeatInterlock)
    per_V2 = 0.5 * pi * limits.capacitance_F * limits.loss_tangent / limits.dissipation_over_s
    rise_V = proof.level_V - limits.voltage_safe_V
    most_W = min(limits.dissipation_max_W, 0.5 * per_V2 * rise_V**2)
    run = proof.hold_level(tightened={"dissipation_max_W": most_W}, cold=True)
    limit_ms = proof.reaction_ms(1)
    risen_V = run.rows["voltage_V"] - limits.voltage_safe_V
    reached_W = per_V2 * float(risen_V.max(initial=0.0)) ** 2
    wrong = (risen_V > sqrt(most_W / per_V2)) | run.tripped  # the sign check adds some before
    return run.step("heat", wrong, limit_ms, (reached_W, most_W, "W"), Cause.OVERHEATED)


def prove_temperature(proof: ProofBench) -> ProofStep:
    """The temperature trip, set below the present temperature."""
    now_C, reason = _temperature_C(proof)
    highest_C = proof.bench.limits.temperature_trip_degC
    if reason or highest_C is None:
        return skipped("temperature", reason)
    trip_C = min(highest_C, now_C - STEP_DEGC)
    run = proof.hold_level(tightened={"temperature_trip_degC": trip_C})
    wrong = run.rows["temperature_C"] > trip_C
    return _temperature_step(proof, "temperature", run, wrong, trip_C, Cause.TEMPERATURE, 1)


def prove_thermometer(proof: ProofBench) -> ProofStep:
    """The trip of a broken thermometer: the lowest plausible temperature is set above the present one."""
    now_C, reason = _temperature_C(proof)
    if reason:
        return skipped("thermometer", reason)
    low_C = max(proof.bench.limits.temperature_low_degC, now_C + STEP_DEGC)
    run = proof.hold_level(tightened={"temperature_low_degC": low_C})
    wrong = run.rows["temperature_C"] < low_C
    cause = Cause.TEMPERATURE_SENSOR
    return _temperature_step(proof, "thermometer", run, wrong, low_C, cause, STRANGE_SAMPLES)


def _temperature_C(proof: ProofBench) -> tuple[float, str]:
    """Present temperature [degC], and the reason why it proves nothing; empty: it does."""
    if proof.bench.limits.temperature_trip_degC is None:
        return 0.0, "limits.temperature_trip_degC is null"
    if not proof.bench.has_role("temperature"):
        return 0.0, "the bench reads no temperature"
    proof.read_force_N()  # one exchange
    now_C = proof.link.reading.temperature_C
    return now_C, "" if isfinite(now_C) else "the device gives no temperature"


def _temperature_step(
    proof: ProofBench, name: str, run: Run, wrong: np.ndarray, limit_C: float, cause: Cause, samples: int
) -> ProofStep:
    limit_ms = proof.reaction_ms(samples)
    read_C = float(run.rows["temperature_C"][0]) if run.rows.size else float("nan")
    return run.step(name, wrong, limit_ms, (read_C, limit_C, "degC"), cause)
