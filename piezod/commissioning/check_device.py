"""Checks of the device over its link: identity, timing of the exchanges, values. Nothing is written to the device."""

import time
from collections.abc import Iterator
from math import isnan

import numpy as np

from piezod.commissioning.check_result import Check
from piezod.config import BenchConfig
from piezod.errors import PiezodError
from piezod.session.assembly import opened_link
from piezod.session.history import percentiles
from piezod.transport import ExchangeResult, Link

READINGS = 100  # number of readings for the timing
LONGEST_IN_TICKS = 0.5  # longest 99th percentile of the duration of a reading, in tick periods


def check_device(bench: BenchConfig) -> Iterator[Check]:
    """Connect the device and check it."""
    try:
        with opened_link(bench) as link:
            yield Check("link", "OK", f"{link.description}, identity as configured")
            yield _exchange(bench, link)
            yield from _values(bench, link)
    except PiezodError as error:
        yield Check("link", "FAIL", str(error))


def _exchange(bench: BenchConfig, link: Link) -> Check:
    """Read at the tick rate, and evaluate results and durations."""
    durations_us = np.empty(READINGS)
    bad = 0
    for k in range(READINGS):
        begun = time.perf_counter()
        bad += link.poll() != ExchangeResult.OK
        durations_us[k] = (time.perf_counter() - begun) * 1e6
        time.sleep(bench.dt_s)
    p99 = percentiles(durations_us)["p99"]
    finding = f"{READINGS - bad} of {READINGS} readings good, median {np.median(durations_us):.0f} us, p99 {p99:.0f} us"
    if bad:
        causes = ", ".join(f"{r.name.lower()} {link.counts[r]}" for r in ExchangeResult if r and link.counts[r])
        return Check("exchange", "FAIL", f"{finding} ({causes})", "check cable, timeout_s and the register map")
    if p99 > LONGEST_IN_TICKS * 1e6 * bench.dt_s:
        return Check("exchange", "WARN", finding, f"lower rate_Hz: a tick lasts {1e6 * bench.dt_s:.0f} us")
    return Check("exchange", "OK", finding)


def _values(bench: BenchConfig, link: Link) -> Iterator[Check]:
    """Check force, voltage read-back and heartbeat of the last reading."""
    reading = link.reading
    limits = bench.limits
    finding = f"{reading.force_N:.3g} N, limits {limits.force_min_N:g} to {limits.force_trip_N:g} N"
    if limits.force_min_N <= reading.force_N <= limits.force_trip_N:
        yield Check("force", "OK", finding)
    else:
        yield Check("force", "FAIL", finding, "check preload, tare, scale and byte order")
    if isnan(reading.voltage_readback_V):
        yield Check("voltage read-back", "WARN", "the device has none", "a wrong output cannot be noticed")
    else:
        rest = abs(reading.voltage_readback_V - limits.voltage_safe_V) <= bench.arming.readback_within_V
        yield Check(
            "voltage read-back",
            "OK" if rest else "WARN",
            f"{reading.voltage_readback_V:.3g} V",
            "" if rest else "arming needs it near the safe voltage; bring the amplifier down",
        )
    if not link.has("heartbeat"):
        yield Check("heartbeat", "WARN", "the device has none", "a frozen device is noticed only by its frozen force")
