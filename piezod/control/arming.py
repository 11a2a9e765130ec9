"""Preconditions of arming: they are checked before the first voltage is written."""

from collections.abc import Callable
from math import isfinite, isnan

from piezod.config import BenchConfig
from piezod.config.sections import ArmingConfig
from piezod.errors import CheckFailedError
from piezod.runtime import clock
from piezod.transport import ExchangeResult, Link, verify_identity

MOST_WAITED_TICKS = 20  # for one new sample
MOST_POLLS = 5  # for one good reading


def check_ready(bench: BenchConfig, link: Link, sleep: Callable[[float], None] | None = None) -> None:
    """Check identity, register map, two force readings, rest and device watchdog; no voltage is written.

    Parameters
    ----------
    bench
        Bench configuration with the limits to check.
    sleep
        Function that waits for a time [s]; None: that of the clock.

    Raises
    ------
    CheckFailedError
        A precondition fails; the message names it.
    IdentityError
        The device, its register map or its byte order differs from the configuration.
    TemporaryError
        The device does not answer.
    """
    check_safeguards(bench)
    verify_identity(link)
    first_N = _force_at_rest(bench, link)
    _wait_for_new_sample(bench, link, sleep or clock.sleep)
    second_N = _force_at_rest(bench, link)
    span_N = bench.limits.force_trip_N - bench.limits.force_min_N
    within_N = bench.arming.agree_within_N or 0.05 * span_N
    if abs(second_N - first_N) > within_N:
        raise CheckFailedError(
            f"arming: two force readings are {first_N:.3g} N and {second_N:.3g} N, must agree within "
            f"{within_N:.3g} N; check load cell and cable"
        )
    _check_at_rest(bench.arming, link.reading.voltage_readback_V, bench.limits.voltage_safe_V)
    _set_device_watchdog(bench, link)


def check_safeguards(bench: BenchConfig) -> None:
    """Refuse a bench without the roles that arming needs, unless `arming.without` lists them.

    Raises
    ------
    CheckFailedError
        A role or the device watchdog is missing; the message names it.
    """
    without = bench.arming.without
    consequence = {
        "identity": "another device would not be noticed",
        "map_version": "another firmware would not be noticed",
        "voltage_readback": "a wrong output would not be noticed",
    }
    for role, noticed in consequence.items():
        named = bench.has_role(role) if role == "voltage_readback" else bench.link.has_role(role)
        if role not in without and not named:
            raise CheckFailedError(
                f"arming: the link names no {role}, so {noticed}; name it, or list it in arming.without"
            )
    if "device_watchdog" not in without and bench.limits.device_watchdog_ms == 0:
        raise CheckFailedError(
            "arming: limits.device_watchdog_ms is 0, must be above 0: the output would stay on when this machine "
            "fails; set it, or list device_watchdog in arming.without"
        )


def _wait_for_new_sample(bench: BenchConfig, link: Link, sleep: Callable[[float], None]) -> None:
    """Wait until the heartbeat changes: two readings of one sample agree even when the load cell is broken."""
    before = link.reading.heartbeat
    for _ in range(MOST_WAITED_TICKS):
        sleep(bench.dt_s)
        if not link.has("heartbeat"):
            return
        if link.poll() == ExchangeResult.OK and link.reading.heartbeat != before:
            return
    raise CheckFailedError(
        f"arming: {link.description}: heartbeat stays at {before} for {MOST_WAITED_TICKS} ticks, must change; "
        "check that the device samples"
    )


def _check_at_rest(arming: ArmingConfig, readback_V: float, safe_V: float) -> None:
    if isnan(readback_V):  # the device has no readback, and arming.without lists it
        return
    if not isfinite(readback_V) or abs(readback_V - safe_V) > arming.readback_within_V:
        raise CheckFailedError(
            f"arming: the amplifier reads back {readback_V:.3g} V, must be within "
            f"{arming.readback_within_V:g} V of {safe_V:g} V; ramp it down first (piezod stop CONFIG)"
        )


def _force_at_rest(bench: BenchConfig, link: Link) -> float:
    """Force of one good reading [N], checked against the force limits."""
    for _ in range(MOST_POLLS):
        if (result := link.poll()) == ExchangeResult.OK:
            break
    else:
        raise CheckFailedError(
            f"arming: {link.description} gives no good reading: {result.name.lower().replace('_', ' ')}"
        )
    force_N = link.reading.force_N
    if not bench.limits.force_min_N <= force_N <= bench.limits.force_trip_N:
        raise CheckFailedError(
            f"arming: force is {force_N:.3g} N at rest, must be within limits.force_min_N, "
            f"{bench.limits.force_min_N:g}, and limits.force_trip_N, {bench.limits.force_trip_N:g}; check preload, tare"
        )
    return force_N


def _set_device_watchdog(bench: BenchConfig, link: Link) -> None:
    wanted_ms = bench.limits.device_watchdog_ms
    if wanted_ms == 0:
        return
    link.write_register("watchdog_ms", wanted_ms)
    found_ms = link.read_register("watchdog_ms")
    if found_ms != wanted_ms:
        raise CheckFailedError(
            f"arming: the device's watchdog reads back {found_ms:g} ms after {wanted_ms} ms were written; "
            "without it the output stays on when this machine fails; check the watchdog_ms register"
        )
