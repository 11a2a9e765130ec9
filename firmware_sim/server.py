"""Builds bench, firmware and connections, and serves them until a signal or the end of standard input."""

import asyncio
import contextlib
import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable

from firmware_sim.config import EmulatorConfig, configured_scenario
from firmware_sim.firmware.device import Device
from firmware_sim.firmware.line import LineProtocol
from firmware_sim.firmware.modbus import ModbusUnit
from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import with_effects
from firmware_sim.wire.lines import serve_lines
from firmware_sim.wire.pty import PseudoTerminal
from firmware_sim.wire.rtu import RtuStation
from firmware_sim.wire.tcp import serve_tcp

BACKGROUND_S = 0.004  # period of the background task that advances the physics
PRIORITY = 70  # real-time priority, below the usual 80 of a controller


def build_device(config: EmulatorConfig, effects: tuple[str, ...] = ()) -> Device:
    """Build the bench and its firmware; the physics is compiled, so that no request waits for it.

    Parameters
    ----------
    effects
        Names of further effects.

    Raises
    ------
    ConfigurationError
        The scenario or the name of an effect is unknown, or a value is invalid.
    """
    bench = Bench(with_effects(configured_scenario(config), effects), seed=config.seed)
    bench.warm_up()
    return Device(bench, config.firmware, config.time, time.monotonic_ns)


def use_realtime_priority() -> None:
    """Run with a real-time priority where the system allows it, and exempt existing objects from garbage collection.

    A real device has a processor of its own and does not wait for the scheduler of this machine.
    """
    gc.collect()
    gc.freeze()
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


async def serve(config: EmulatorConfig, device: Device, *, until_stdin_closes: bool) -> None:
    """Serve until SIGTERM, SIGINT or, with `until_stdin_closes`, the end of standard input."""
    async with contextlib.AsyncExitStack() as stack:
        ready = await _open(config, device, stack)
        stopped = asyncio.Event()
        _stop_on_signals(stopped, until_stdin_closes=until_stdin_closes)
        sys.stdout.write(json.dumps({"ready": True, **ready, "time": config.time}) + "\n")
        sys.stdout.flush()
        background = asyncio.create_task(_advance_in_background(device))
        await stopped.wait()
        background.cancel()


async def _open(config: EmulatorConfig, device: Device, stack: contextlib.AsyncExitStack) -> dict[str, str]:
    """Open every configured connection; return the address of each."""
    unit, ready = ModbusUnit(device), {}
    if config.tcp is not None:
        server = await serve_tcp(unit, config.tcp)
        stack.callback(server.close)
        ready["tcp"] = _address(server)
    if config.rtu is not None:
        station = RtuStation(unit, config.rtu.unit_id, time.monotonic_ns)
        ready["rtu"] = _open_pty(station.received, config.rtu.link, stack)
    if config.line is not None and config.line.pty:
        ready["line"] = _open_pty(LineProtocol(device, config.line).received, config.line.link, stack)
    if config.line is not None and config.line.tcp_port is not None:
        server = await serve_lines(device, config.line, config.line.tcp_port)
        stack.callback(server.close)
        ready["line_tcp"] = _address(server)
    return ready


def _open_pty(received: Callable[[bytes], bytes], link: str | None, stack: contextlib.AsyncExitStack) -> str:
    terminal = PseudoTerminal(received, link)
    stack.callback(terminal.close)
    return terminal.path


def _address(server: asyncio.Server) -> str:
    host, port = server.sockets[0].getsockname()[:2]
    return f"{host}:{port}"


async def _advance_in_background(device: Device) -> None:
    """Advance the physics between requests, so that the watchdog acts without a request."""
    while not device.virtual:
        device.catch_up()
        await asyncio.sleep(BACKGROUND_S)


def _stop_on_signals(stopped: asyncio.Event, *, until_stdin_closes: bool) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stopped.set)
    if until_stdin_closes:
        threading.Thread(target=_wait_for_stdin, args=(loop, stopped), daemon=True).start()


def _wait_for_stdin(loop: asyncio.AbstractEventLoop, stopped: asyncio.Event) -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    with contextlib.suppress(RuntimeError):  # the loop has ended already
        loop.call_soon_threadsafe(stopped.set)
