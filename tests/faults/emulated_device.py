"""An emulated device with injectable faults and a proxy before it, served by a separate process.

`python -m tests.faults.emulated_device SETTINGS` (JSON) serves until its standard input ends. Each input line is a JSON
command; the answer is one JSON line. A judge checks the output of the emulated amplifier at each physics step. The
times are those of the monotonic clock.
"""

import asyncio
import contextlib
import json
import math
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from pymodbus.pdu import ModbusPDU

from firmware_sim.config import Firmware, Tcp
from firmware_sim.firmware.device import Device
from firmware_sim.firmware.modbus import ModbusUnit
from firmware_sim.physics.bench import Bench, Sample
from firmware_sim.physics.scenario import load_scenario, with_effects
from firmware_sim.server import BACKGROUND_S, use_realtime_priority
from firmware_sim.wire.pty import PseudoTerminal
from firmware_sim.wire.rtu import RtuStation
from firmware_sim.wire.tcp import serve_tcp
from tests.contract.judged_bench import Judge, JudgedBench
from tests.faults.proxy import PtyProxy, Rule, TcpProxy

REST_V = 0.5  # largest output that counts as rest [V]


class TimedJudge(Judge):
    """Judge that also records when the device took over and when its output reached rest [ns, monotonic]."""

    def __init__(self, *envelope: float) -> None:
        super().__init__(*envelope)
        self.mark()

    def mark(self) -> None:
        """Clear the recorded times and the highest voltage."""
        self.taken_over_ns: int | None = None
        self.rest_ns: int | None = None
        self.highest_V = -math.inf

    def time(self, output_V: float, tripped: bool, now_ns: int) -> None:
        """Record one physics step.

        Parameters
        ----------
        output_V
            Output of the amplifier [V].
        tripped
            Whether the watchdog of the device has taken over.
        now_ns
            Time of the step [ns, monotonic].
        """
        self.highest_V = max(self.highest_V, output_V)
        if tripped and self.taken_over_ns is None:
            self.taken_over_ns = now_ns
        if abs(output_V) > REST_V:
            self.rest_ns = None
        elif self.rest_ns is None:
            self.rest_ns = now_ns


class TimedBench(JudgedBench):
    """Bench that passes each physics step and its time to the judge."""

    time_of: Callable[[int], int] = staticmethod(lambda _step: 0)

    def advance_steps(self, steps: int) -> None:
        """Advance by single steps, each of which the judge sees."""
        for k in range(steps):
            Bench.advance_steps(self, 1)
            output_V = self.output_V
            self.judge.see(output_V, int(self._state["steps"][0]))
            self.judge.time(output_V, bool(self._state["tripped"][0]), self.time_of(k + 1))


class FaultyDevice(Device):
    """An emulated device with false readings on request.

    Attributes
    ----------
    reading_fault
        Function from the true reading to the reported one; None: the readings are true.
    acts_on_watchdog
        Whether the watchdog acts whose time it keeps.
    commands
        Number of set points received.
    command_ns, requested_V
        Time [ns, monotonic] and voltage [V] of the last set point.
    """

    def __init__(self, bench: TimedBench, firmware: Firmware) -> None:
        self.reading_fault: Callable[[Sample], Sample] | None = None
        self.commands = self.command_ns = 0
        self.acts_on_watchdog = True
        self.requested_V = 0.0
        super().__init__(bench, firmware, "real", time.monotonic_ns)
        bench.time_of = lambda step: self._start_ns + round((self._done_steps + step) / self._steps_per_ns)

    def sample(self) -> Sample:
        """Return the present reading, changed by `reading_fault`."""
        sample = super().sample()
        return sample if self.reading_fault is None else self.reading_fault(sample)

    def write(self, address: int, values: Any) -> None:
        """Write registers; a set point is counted."""
        if address == 110 and not self.acts_on_watchdog:
            self._set_watchdog(0)
            self._words[110] = values[0]
            return
        if address == 100:
            self.commands += 1
            self.command_ns = time.monotonic_ns()
            self.requested_V = struct.unpack(">f", struct.pack(">2H", *values[:2]))[0]
        super().write(address, values)


class FaultyUnit(ModbusUnit):
    """Modbus unit whose judge excuses set points of other clients."""

    def __init__(self, device: Device, judge: TimedJudge) -> None:
        super().__init__(device)
        self._judge = judge

    def reply(self, frame: bytes, unit_id: int, transaction_id: int) -> ModbusPDU:
        """Return the answer."""
        if frame[0] in (6, 16) and frame[1:3] == b"\0\x64":  # not the daemon, which writes with function 23
            self.device.catch_up()
            self._judge.excused = True
        return super().reply(frame, unit_id, transaction_id)


def false_readings(kind: str, value: float | None = None) -> Callable[[Sample], Sample]:
    """A function that keeps one quantity of the readings at a value; without one, at its first."""
    name, first = STUCK[kind], [] if value is None else [value]

    def read(sample: Sample) -> Sample:
        if not first:
            first.append(getattr(sample, name))
        return replace(sample, **{name: first[0]})

    return read


STUCK = {"stuck": "force_N", "readback_stuck": "voltage_readback_V", "hot": "temperature_C"}


class FaultServer:
    """Device and proxy, and the commands that control them; `do_NAME` executes the command NAME."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._settings = settings
        scenario = with_effects(load_scenario("stack"), tuple(settings.get("effects", ())))
        self.bench = TimedBench(scenario, seed=1)
        self.bench.warm_up()
        self.bench.judge = self.judge = TimedJudge(*settings["envelope"], self.bench.step_s)
        self.device = FaultyDevice(self.bench, Firmware())
        self.unit = FaultyUnit(self.device, self.judge)
        self.proxy: TcpProxy | PtyProxy | None = None
        self.behind_s = 0.0  # largest delay of a wake-up of this process since the mark

    async def open(self, stack: contextlib.AsyncExitStack) -> dict[str, Any]:
        """Serve; returns the addresses."""
        host = self._settings.get("host", "127.0.0.1")
        one_client = bool(self._settings.get("one_client"))
        server = await serve_tcp(self.unit, Tcp(host=host, port=0, one_client=one_client))
        stack.callback(server.close)
        port = server.sockets[0].getsockname()[1]
        ready: dict[str, Any] = {"direct": f"{host}:{port}"}
        if self._settings.get("wire") == "rtu":
            terminal = PseudoTerminal(RtuStation(self.unit, 1, time.monotonic_ns).received, None)
            stack.callback(terminal.close)
            pty_proxy = PtyProxy(terminal.path, Path(self._settings["link"]))
            await pty_proxy.open()
            self.proxy = pty_proxy
            ready["rtu"] = self._settings["link"]
        else:
            tcp_proxy = TcpProxy((host, port))
            ready["tcp"] = f"{host}:{await tcp_proxy.open(host)}"
            self.proxy = tcp_proxy
        stack.push_async_callback(self.proxy.close)
        return ready

    async def execute(self, command: dict[str, Any]) -> dict[str, Any]:
        """Execute one command and return its answer."""
        name = command.pop("do")
        return await getattr(self, f"do_{name}")(**command)

    async def do_rules(self, rules: list[dict[str, Any]]) -> dict[str, Any]:
        """Set the rules of the proxy."""
        self.proxy.schedule([Rule(**rule) for rule in rules])
        return self._now()

    async def do_wire(self, what: str) -> dict[str, Any]:
        """Apply an action of `TcpProxy.act` or `PtyProxy.act` to the connections."""
        await self.proxy.act(what)
        return self._now()

    async def do_reading_fault(self, kind: str = "", value: float | None = None) -> dict[str, Any]:
        """Report a quantity that stands still; without a kind, true readings."""
        self.device.reading_fault = false_readings(kind, value) if kind else None
        return self._now()

    async def do_other_device(self, acts_on_watchdog: bool = True) -> dict[str, Any]:
        """Become a firmware that keeps the time of its watchdog and does not act on it; by default, the first one."""
        self.device.acts_on_watchdog = acts_on_watchdog
        if not acts_on_watchdog:
            self.device._set_watchdog(0)
        return self._now()

    async def do_mark(self) -> dict[str, Any]:
        """Start a new measurement: clear times and counts."""
        self.device.catch_up()
        self.judge.mark()
        self.proxy.done.clear()
        self.behind_s = 0.0
        self.device.commands = 0
        return self._now()

    async def do_report(self) -> dict[str, Any]:
        """Times and counts since the mark, and violations of the envelope since the last report."""
        self.device.catch_up()
        wrong, self.judge.wrong = self.judge.wrong, []
        return self._now() | {
            "wrong": wrong[:5],
            "output_V": self.bench.output_V,
            "command_V": self.bench.command_V,
            "force_N": self.bench.true_force_N,
            "highest_V": self.judge.highest_V,
            "taken_over_ns": self.judge.taken_over_ns,
            "rest_ns": self.judge.rest_ns,
            "command_ns": self.device.command_ns,
            "requested_V": self.device.requested_V,
            "commands": self.device.commands,
            "watchdog_ms": self.device.watchdog_ms,
            "accepted": getattr(self.proxy, "accepted", 0),
            "deeds": len(self.proxy.done),
            "behind_ms": 1e3 * self.behind_s,
        }

    def _now(self) -> dict[str, Any]:
        return {"now_ns": time.monotonic_ns()}

    async def keep_up(self) -> None:
        """Advance the physics between requests, and measure how late this process wakes up."""
        while True:
            self.device.catch_up()
            begun_s = time.monotonic()
            await asyncio.sleep(BACKGROUND_S)
            self.behind_s = max(self.behind_s, time.monotonic() - begun_s - BACKGROUND_S)


async def _serve(settings: dict[str, Any]) -> None:
    async with contextlib.AsyncExitStack() as stack:
        server = FaultServer(settings)
        _answer(await server.open(stack))
        background = asyncio.create_task(server.keep_up())
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            _answer(await server.execute(json.loads(line)))
        background.cancel()


def _answer(answer: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    use_realtime_priority()
    asyncio.run(_serve(json.loads(sys.argv[1])))
