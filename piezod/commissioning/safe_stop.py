"""`piezod stop --direct`: bring a bench to rest without its daemon, with the limits and the loop of the daemon.

A program that drives the bench gets the stop first, at its stop socket. Without an answer its lock must become free.
systemd runs it after a daemon has failed (`ExecStopPost`). An operator runs it when a voltage is left at the output.
"""

import contextlib
from math import isfinite, nan
from pathlib import Path

from piezod.config import BenchConfig
from piezod.control import CAUSE_TEXT, Cause, RingLog
from piezod.daemon import client, stop_path
from piezod.errors import CheckFailedError, PiezodError, UnreachableError
from piezod.runtime import clock
from piezod.session.assembly import load_bench_without_model, make_loop, make_rate_keeper, opened_link
from piezod.session.lock import lock_bench
from piezod.transport import ExchangeResult, Link
from piezod.transport.status import STATUS_WATCHDOG

LOCK_WITHIN_S = 2.0
"""Longest time to wait for the lock, besides the time of a ramp [s].

A control process whose parent was killed holds the lock until it has ramped down.
"""
POLLS = 5  # number of attempts to read the output
POLL_INTERVAL_S = 0.05
WATCHDOG_POLL_INTERVAL_S = 0.2  # time between two readings while the watchdog of the device ramps down [s]


def stop_directly(path: Path) -> str:
    """Stop the program that drives the bench, else drive the output to the safe voltage; read it back.

    Parameters
    ----------
    path
        Bench configuration.

    Returns
    -------
    str
        Voltage before and after, for a message.

    Raises
    ------
    BusyError
        Another program holds the lock of the bench, and does not answer or does not reach the device.
    TemporaryError, ConfigurationError
        The device does not answer, or is not the configured device.
    CheckFailedError
        The output is unknown, or did not come to rest.
    """
    bench = load_bench_without_model(path)
    limits = bench.limits
    ramp_s = (limits.voltage_max_V - limits.voltage_min_V) / limits.ramp_down_V_per_s
    if driven := _stop_driver(bench):
        return driven
    lock = lock_bench(bench, wait_s=LOCK_WITHIN_S + ramp_s, stopping=True)
    try:
        with opened_link(bench) as link:
            return bring_to_rest(bench, link)
    finally:
        lock.close()


def _stop_driver(bench: BenchConfig) -> str:
    """Stop the program that drives the bench; return a message with its state at rest, empty without a program."""
    with contextlib.suppress(PiezodError):
        stop_path.urge(bench.stop_socket_path, "stop", client.URGE_WITHIN_S)  # a program that hangs is left alone
        status = client.command_and_wait(bench.socket_path, "stop", wait=True)
        output_V = status.get("readback_V")
        at_rest = status.get("state") == "DISARMED" if output_V is None else _at_rest(bench, output_V)
        if at_rest and status["connected"] and not status["stale"]:
            return f"{bench.stop_socket_path}: stopped by the program that drives; at rest, {status['state']}"
    return ""


def bring_to_rest(bench: BenchConfig, link: Link) -> str:
    """Drive the output to the safe voltage and read it back; the caller holds the lock.

    Nothing is written if the readback and the command in the device are both at rest.

    Parameters
    ----------
    bench, link
        Bench configuration and its opened link.

    Returns
    -------
    str
        Voltage before and after, for a message.

    Raises
    ------
    TemporaryError
        The device does not answer.
    CheckFailedError
        The output is unknown, or did not come to rest.
    """
    before_V = _output_V(bench, link)
    if link.reading.status & STATUS_WATCHDOG:  # the device ramps down itself; a command now would cause a jump
        before_V = commanded_V = _wait_for_rest(bench, link)
    else:
        commanded_V = _commanded_V(link)
    if abs(before_V) < abs(bench.limits.voltage_safe_V) and not _at_rest(bench, before_V):
        return f"{link.description}: {before_V:.2f} V, below limits.voltage_min_V; nothing written: a stop only lowers"
    if _at_rest(bench, before_V) and _at_rest(bench, commanded_V):
        return f"{link.description}: {before_V:.2f} V, at rest"
    if _at_rest(bench, before_V):  # the readback may stand still: the ramp begins where the command stands
        before_V = commanded_V if isfinite(commanded_V) else before_V
    fault = _ramp(bench, link, before_V)
    after_V = _output_V(bench, link)
    remark = "" if fault is Cause.NONE else f"; {CAUSE_TEXT[fault]}"
    if not _at_rest(bench, after_V):
        where = f"{link.description} is still at {after_V:.2f} V{remark}"
        raise CheckFailedError(f"stop: {where}; switch the amplifier off")
    return f"{link.description}: ramped down from {before_V:.2f} V, {after_V:.2f} V now{remark}"


def _at_rest(bench: BenchConfig, voltage_V: float) -> bool:
    return abs(voltage_V - bench.limits.voltage_safe_V) <= bench.arming.readback_within_V


def _commanded_V(link: Link) -> float:
    """The last command in the register of the device [V]; nan where it cannot be read."""
    for _ in range(POLLS):
        with contextlib.suppress(PiezodError):
            return link.read_register("voltage_setpoint")
        clock.sleep(POLL_INTERVAL_S)
    return nan


def _ramp(bench: BenchConfig, link: Link, from_V: float) -> Cause:
    ring_log = RingLog(None, round(bench.rate_Hz))  # without a file: a full file system must not prevent a stop
    try:
        return make_loop(bench, link, make_rate_keeper(bench, link), ring_log).bring_down(from_V)
    finally:
        ring_log.close()


def _wait_for_rest(bench: BenchConfig, link: Link) -> float:
    """Wait until the output is at rest or falls no more; return it [V]."""
    output_V = _output_V(bench, link)
    while not _at_rest(bench, output_V):
        clock.sleep(WATCHDOG_POLL_INTERVAL_S)
        before_V, output_V = output_V, _output_V(bench, link)
        if abs(output_V - before_V) < 0.1 * bench.arming.readback_within_V:
            break
    return output_V


def _output_V(bench: BenchConfig, link: Link) -> float:
    """Voltage at the output [V]: the read-back voltage, else the last command in the register."""
    for _ in range(POLLS):
        result = link.poll()
        if result == ExchangeResult.OK:
            break
        clock.sleep(POLL_INTERVAL_S)
    else:
        raise UnreachableError(f"stop: {link.description} gives no good reading: {result.name.lower()}; try again")
    if isfinite(link.reading.voltage_readback_V):
        return link.reading.voltage_readback_V
    if bench.link.kind == "serial_line":
        raise CheckFailedError(
            f"stop: {link.description} reports neither output nor command, and a command could cause a jump; "
            "switch the amplifier off"
        )
    return link.read_register("voltage_setpoint")
