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
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pymodbus.pdu import ExceptionResponse, ModbusPDU

from firmware_sim.config import Firmware, Tcp
from firmware_sim.errors import RefusedError
from firmware_sim.firmware.device import IDENTITY, MAP_VERSION, ORDER_CHECK, Device
from firmware_sim.firmware.modbus import ModbusUnit
from firmware_sim.physics.bench import Bench, Sample
from firmware_sim.physics.scenario import load_scenario, with_effects
from firmware_sim.server import BACKGROUND_S, use_realtime_priority
from firmware_sim.wire.pty import PseudoTerminal
from firmware_sim.wire.rtu import RtuStation
from firmware_sim.wire.tcp import serve_tcp
from tests.contract.judged_bench import Judge, JudgedBench, restart
from tests.faults.proxy import PtyProxy, Rule, TcpProxy

IN_FLIGHT_TURNS = 3  # turns of the event loop until forwarded frames reach the device; a reconnection takes longer
SLIDE_N_PER_S = 1000.0  # slower than the force rate trip of the bench
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
    """An emulated device with false readings and ignored writes on request.

    Attributes
    ----------
    reading_fault
        Function from the true reading to the reported one; None: the readings are true.
    ignores_writes
        Whether it acknowledges a set point without applying it.
    commands
        Number of set points received.
    command_ns, requested_V
        Time [ns, monotonic] and voltage [V] of the last set point.
    foreign_ns
        Time of the last set point of `second_master`, which is in no other count [ns, monotonic].
    """

    def __init__(self, bench: TimedBench, firmware: Firmware) -> None:
        self.reading_fault: Callable[[Sample], Sample] | None = None
        self.ignores_writes = False
        self.commands = self.commands_to_other = 0
        self.shift = 0  # registers by which a changed map is shifted
        self.is_other = False
        self.keeps_watchdog = self.acts_on_watchdog = True
        self.command_ns = self.foreign_ns = 0
        self.requested_V = 0.0
        super().__init__(bench, firmware, "real", time.monotonic_ns)
        bench.time_of = lambda step: self._start_ns + round((self._done_steps + step) / self._steps_per_ns)

    def sample(self) -> Sample:
        """Return the present reading, changed by `reading_fault`."""
        sample = super().sample()
        return sample if self.reading_fault is None else self.reading_fault(sample)

    def write(self, address: int, values: Any) -> None:
        """Write registers; a set point is counted and, with `ignores_writes`, not applied."""
        address += self.shift
        if address == 110 and not self.keeps_watchdog:
            return
        if address == 110 and not self.acts_on_watchdog:
            self._set_watchdog(0)
            self._words[110] = values[0]
            return
        if address == 100:
            self.commands += 1
            self.commands_to_other += self.is_other
            self.command_ns = time.monotonic_ns()
            self.requested_V = struct.unpack(">f", struct.pack(">2H", *values[:2]))[0]
            if self.ignores_writes:
                self._words[102] = values[2] if len(values) > 2 else self._words[102]
                self.bench.feed_watchdog()
                return
        super().write(address, values)

    def read(self, address: int, count: int) -> list[int]:
        """Read registers, from a shifted address where the map has changed."""
        return super().read(address + self.shift, count)


class FaultyUnit(ModbusUnit):
    """Modbus unit that answers with exceptions on request; the judge excuses set points of other clients."""

    def __init__(self, device: Device, judge: TimedJudge) -> None:
        super().__init__(device)
        self._judge = judge
        self.refusal: tuple[int, int, int] = (0, 0, 0)  # exception code, function (0: all), count (-1: no end)
        self.refused_address = -1  # only requests for this address; -1: all

    def reply(self, frame: bytes, unit_id: int, transaction_id: int) -> ModbusPDU:
        """Return the answer, or the requested exception."""
        if frame[0] in (6, 16) and frame[1:3] == b"\0\x64":  # not the daemon, which writes with function 23
            self.device.catch_up()
            self._judge.excused = True
        code, function, count = self.refusal
        addressed = self.refused_address in (-1, int.from_bytes(frame[1:3], "big"))
        if count and addressed and function in (0, frame[0]):
            self.refusal = (code, function, count - 1)
            answer = ExceptionResponse(frame[0], code)
            answer.dev_id, answer.transaction_id = unit_id, transaction_id
            return answer
        return super().reply(frame, unit_id, transaction_id)


def false_readings(kind: str, value: float, count: int) -> Callable[[Sample], Sample]:
    """A function that turns true readings into those of a defective load cell, monitor or firmware.

    Parameters
    ----------
    kind
        A key of `_FALSE_READINGS`.
    value
        Size of the fault, in the unit of the quantity that it changes.
    count
        Number of false readings; 0: no end.
    """
    memory: dict[str, Any] = {"n": 0, "first": None, "begun_ns": time.monotonic_ns()}

    def read(sample: Sample) -> Sample:
        memory["n"] += 1
        if count and memory["n"] > count:
            return sample
        memory["first"] = memory["first"] or sample
        return _FALSE_READINGS[kind](sample, value, memory)

    return read


_FALSE_READINGS: dict[str, Callable[[Sample, float, dict[str, Any]], Sample]] = {
    "force": lambda sample, value, _: replace(sample, force_N=value),
    "offset": lambda sample, value, _: replace(sample, force_N=sample.force_N + value),
    "creep": lambda sample, value, memory: replace(
        sample, force_N=sample.force_N + value * 1e-9 * (time.monotonic_ns() - memory["begun_ns"])
    ),
    "reversed": lambda sample, _value, _told: replace(sample, force_N=-sample.force_N),
    "gain": lambda sample, value, _: replace(sample, force_N=sample.force_N * value),
    "stuck": lambda sample, _value, memory: replace(sample, force_N=memory["first"].force_N),
    "frozen": lambda _sample, _value, memory: memory["first"],
    "heartbeat_back": lambda sample, value, _: replace(sample, heartbeat=(sample.heartbeat - int(value)) & 0xFFFF),
    "gain_creep": lambda sample, value, memory: replace(
        sample, force_N=sample.force_N * (1 + value * 1e-9 * (time.monotonic_ns() - memory["begun_ns"]))
    ),
    "heartbeat_stuck": lambda sample, _value, memory: replace(sample, heartbeat=memory["first"].heartbeat),
    "heartbeat_reversed": lambda sample, _value, _memory: replace(sample, heartbeat=-sample.heartbeat & 0xFFFF),
    "readback_stuck": lambda sample, _value, memory: replace(
        sample, voltage_readback_V=memory["first"].voltage_readback_V
    ),
    "slides": lambda sample, value, memory: replace(
        sample, force_N=max(value, sample.force_N - SLIDE_N_PER_S * 1e-9 * (time.monotonic_ns() - memory["begun_ns"]))
    ),
    "every_2": lambda sample, value, memory: sample if memory["n"] % 2 else replace(sample, force_N=value),
    "every_3": lambda sample, value, memory: sample if memory["n"] % 3 else replace(sample, force_N=value),
    "temperature": lambda sample, value, _: replace(sample, temperature_C=value),
    "readback": lambda sample, value, _: replace(sample, voltage_readback_V=value),
}


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

    async def do_reading_fault(self, kind: str = "", value: float | str = 0.0, count: int = 0) -> dict[str, Any]:
        """Report false readings; without a kind, true ones. The value may be the word nan or inf."""
        self.device.reading_fault = false_readings(kind, float(value), count) if kind else None
        return self._now()

    async def do_refuse(self, code: int, function: int = 0, count: int = -1, address: int = -1) -> dict[str, Any]:
        """Answer with exceptions; a count of 0 stops them."""
        self.unit.refusal = (code, function, count)
        self.unit.refused_address = address
        return self._now()

    async def do_ignore_writes(self, ignored: bool) -> dict[str, Any]:
        """Acknowledge set points without applying them."""
        self.device.ignores_writes = ignored
        return self._now()

    async def do_fault_bits(self, bits: int) -> dict[str, Any]:
        """Trip the amplifier, whose output then falls; 0 switches it on again, at rest."""
        self.device.catch_up()
        self.judge.excused = True
        if not bits:
            self.bench._state["command_V"] = 0.0
        self.bench.set_fault(bits)
        return self._now()

    async def do_restart(self) -> dict[str, Any]:
        """Restart the firmware. The connections are reset first, so that no earlier request reaches the new state."""
        await self.proxy.act("reset")
        for _ in range(IN_FLIGHT_TURNS):
            await asyncio.sleep(0)
        self.device.catch_up()
        restart(self.device, self.bench)
        return self._now()

    async def do_second_master(self, above_V: float, times: int, every_s: float) -> dict[str, Any]:
        """Write the set point as a second client does: `above_V` above the present one, `times` times."""
        begun = self._now()
        for _ in range(times):
            self.device.catch_up()
            self.judge.excused = True
            words = struct.unpack(">2H", struct.pack(">f", self.device.requested_V + above_V))
            with contextlib.suppress(RefusedError):  # outside the range of the device
                Device.write(self.device, 100, [*words, self.device.command_echo])
                self.device.foreign_ns = time.monotonic_ns()
            await asyncio.sleep(every_s)
        return begun

    async def do_other_device(
        self,
        words: dict[str, int] | None = None,
        shift: int = 0,
        resets: bool = False,
        keeps_watchdog: bool = True,
        acts_on_watchdog: bool = True,
    ) -> dict[str, Any]:
        """Become another device or firmware: other words at some addresses, or a shifted map; nothing given: the first.

        With `resets`, the connections are reset, and the other device answers the next one.
        """
        if resets:
            await self.proxy.act("reset")
            for _ in range(IN_FLIGHT_TURNS):
                await asyncio.sleep(0)
        device = self.device
        device._words[0:4] = [IDENTITY, MAP_VERSION, *struct.unpack(">2H", struct.pack(">f", ORDER_CHECK))]
        for address, word in (words or {}).items():
            device._words[int(address)] = word
        device.shift, device.keeps_watchdog = shift, keeps_watchdog
        device.acts_on_watchdog = acts_on_watchdog
        device.is_other = bool(words or shift)
        return self._now()

    async def do_lose_settings(self) -> dict[str, Any]:
        """Restart the firmware so fast that output and sample counter stay; only its settings are lost."""
        await self.proxy.act("reset")
        for _ in range(IN_FLIGHT_TURNS):
            await asyncio.sleep(0)
        Device.write(self.device, 110, [0])
        return self._now()

    async def do_idle(self, closes_after_s: float) -> dict[str, Any]:
        """Close connections that are silent for this time [s]; 0: never."""
        self.proxy.idle_s = closes_after_s
        return self._now()

    async def do_mark(self) -> dict[str, Any]:
        """Start a new measurement: clear times and counts."""
        self.device.catch_up()
        self.judge.mark()
        self.proxy.done.clear()
        self.proxy.late_s = self.behind_s = 0.0
        self.device.commands = self.device.commands_to_other = 0
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
            "foreign_ns": self.device.foreign_ns,
            "commands": self.device.commands,
            "commands_to_other": self.device.commands_to_other,
            "watchdog_ms": self.device.watchdog_ms,
            "passed": self.proxy.passed,
            "accepted": getattr(self.proxy, "accepted", 0),
            "done": [asdict(action) for action in self.proxy.done[:50]],
            "deeds": len(self.proxy.done),
            "late_ms": 1e3 * self.proxy.late_s,
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
