"""Bring a bench to rest without its daemon: a connection of its own, the same limits, the same loop.

For systemd's ExecStopPost, and for whoever finds a voltage that nobody drives any more.
"""

import time
from math import isfinite
from pathlib import Path

from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, RingLog
from piezod.errors import CheckFailedError, UnreachableError
from piezod.session.assembly import load_without_model, make_loop, make_rate_keeper, opened_link
from piezod.session.lock import BenchLock
from piezod.transport import ExchangeResult, Link
from piezod.transport.status import STATUS_WATCHDOG

LOCK_WITHIN_S = 2.0  # and the time of a ramp: a control process whose parent was killed holds the lock until its end
LOOKS = 5
LOOK_AGAIN_S = 0.05


def stop_directly(path: Path) -> str:
    """Drive the output to the safe voltage and read it back; says what was found and done.

    Parameters
    ----------
    path
        Bench configuration.

    Raises
    ------
    BusyError
        A daemon drives the bench; tell it to stop.
    TemporaryError, ConfigurationError
        The device does not answer, or is another one than configured.
    CheckFailedError
        The output is not known, or did not come to rest.
    """
    bench = load_without_model(path)
    limits = bench.limits
    ramp_s = (limits.voltage_max_V - limits.voltage_min_V) / limits.ramp_down_V_per_s
    lock = BenchLock(bench.lock_path, wait_s=LOCK_WITHIN_S + ramp_s)
    try:
        with opened_link(bench) as link:
            return _bring_to_rest(bench, link)
    finally:
        lock.close()


def _bring_to_rest(bench: BenchConfig, link: Link) -> str:
    found_V = _output_V(bench, link)
    if link.reading.status & STATUS_WATCHDOG:  # the device ramps by itself; a command now would be a jump
        found_V = _wait_for_rest(bench, link)
    if abs(found_V - bench.limits.voltage_safe_V) <= bench.arming.readback_within_V:
        return f"{link.description}: {found_V:.2f} V, at rest"
    fault = _ramp(bench, link, found_V)
    left_V = _output_V(bench, link)
    remark = "" if fault is Cause.NONE else f"; {CAUSE_TEXT[fault]}"
    if abs(left_V - bench.limits.voltage_safe_V) > bench.arming.readback_within_V:
        raise CheckFailedError(f"stop: {link.description} is still at {left_V:.2f} V{remark}; switch the amplifier off")
    return f"{link.description}: ramped down from {found_V:.2f} V, {left_V:.2f} V now{remark}"


def _ramp(bench: BenchConfig, link: Link, from_V: float) -> Cause:
    ring = RingLog(bench.ring_log_path, round(bench.rate_Hz))
    try:
        return make_loop(bench, link, make_rate_keeper(bench, link), ring).bring_down(from_V)
    finally:
        ring.close()
        bench.ring_log_path.unlink(missing_ok=True)


def _wait_for_rest(bench: BenchConfig, link: Link) -> float:
    """The output [V] once it is at rest, or no longer falls."""
    output_V = _output_V(bench, link)
    while abs(output_V - bench.limits.voltage_safe_V) > bench.arming.readback_within_V:
        time.sleep(0.2)
        before_V, output_V = output_V, _output_V(bench, link)
        if abs(output_V - before_V) < 0.1 * bench.arming.readback_within_V:
            break
    return output_V


def _output_V(bench: BenchConfig, link: Link) -> float:
    """What the output is [V]: as read back, else as last commanded."""
    for _ in range(LOOKS):
        result = link.poll()
        if result == ExchangeResult.OK:
            break
        time.sleep(LOOK_AGAIN_S)
    else:
        raise UnreachableError(f"stop: {link.description} gives no good reading: {result.name.lower()}; try again")
    if isfinite(link.reading.voltage_readback_V):
        return link.reading.voltage_readback_V
    if bench.link.kind == "serial_line":
        raise CheckFailedError(
            f"stop: {link.description} tells neither output nor command, and a blind command could be a jump; "
            "switch the amplifier off"
        )
    return link.read_register("voltage_setpoint")
