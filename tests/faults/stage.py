"""The other side of a fault, as one process: an emulated device whose output is judged, and the proxy in front of it.

`python -m tests.faults.stage SETTINGS` (JSON) serves until its standard input ends. Each line of input is a command and
is answered with a line, both JSON. What is judged is the output of the emulated amplifier, physics step by physics
step, in the time that the machine's monotonic clock shows.
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
from firmware_sim.firmware.device import Device
from firmware_sim.firmware.modbus import ModbusUnit
from firmware_sim.physics.bench import Bench, Sample
from firmware_sim.physics.scenario import load_scenario, with_effects
from firmware_sim.server import BACKGROUND_S, use_realtime_priority
from firmware_sim.wire.pty import PseudoTerminal
from firmware_sim.wire.rtu import RtuStation
from firmware_sim.wire.tcp import serve_tcp
from tests.contract.judged_bench import Judge, JudgedBench, restart
from tests.faults.proxy import PtyProxy, Rule, TcpProxy

IN_FLIGHT_TURNS = 3  # of the event loop: what the proxy passed on is with the device then; to reconnect takes more
REST_V = 0.5  # so near to zero the output is at rest
RAIL_N = 32767.0  # of a converter whose counts are taken for newtons


class TimedJudge(Judge):
    """Keeps, beside the envelope, when the device took over and when it came to rest [ns, monotonic]."""

    def __init__(self, *envelope: float) -> None:
        super().__init__(*envelope)
        self.mark()

    def mark(self) -> None:
        """Forget the times."""
        self.taken_over_ns: int | None = None
        self.rest_ns: int | None = None
        self.highest_V = -math.inf

    def time(self, output_V: float, tripped: bool, now_ns: int) -> None:
        """One physics step."""
        self.highest_V = max(self.highest_V, output_V)
        if tripped and self.taken_over_ns is None:
            self.taken_over_ns = now_ns
        if abs(output_V) > REST_V:
            self.rest_ns = None
        elif self.rest_ns is None:
            self.rest_ns = now_ns


class StagedBench(JudgedBench):
    """Shows each physics step to the judge, with the time that it stands for."""

    time_of: Callable[[int], int] = staticmethod(lambda _step: 0)

    def advance_steps(self, steps: int) -> None:
        """Step by step."""
        for k in range(steps):
            Bench.advance_steps(self, 1)
            output_V = self.output_V
            self.judge.see(output_V, int(self._state["steps"][0]))
            self.judge.time(output_V, bool(self._state["tripped"][0]), self.time_of(k + 1))


class StagedDevice(Device):
    """A device that can be made to lie, to forget and to refuse.

    Attributes
    ----------
    lie
        What its readings are turned into.
    deaf_to_writes
        Acknowledges the set point and leaves it where it is.
    commands
        Set points that it took; `command_ns` is the time of the last one, `asked_V` its voltage.
    """

    def __init__(self, bench: StagedBench, firmware: Firmware) -> None:
        self.lie: Callable[[Sample], Sample] | None = None
        self.deaf_to_writes = False
        self.commands = 0
        self.command_ns = 0
        self.asked_V = 0.0
        super().__init__(bench, firmware, "real", time.monotonic_ns)
        bench.time_of = lambda step: self._start_ns + round((self._done_steps + step) / self._steps_per_ns)

    def sample(self) -> Sample:
        """Return the present reading, or a lie."""
        sample = super().sample()
        return sample if self.lie is None else self.lie(sample)

    def write(self, address: int, values: Any) -> None:
        """Write registers."""
        if address == 100:
            self.commands += 1
            self.command_ns = time.monotonic_ns()
            self.asked_V = struct.unpack(">f", struct.pack(">2H", *values[:2]))[0]
            if self.deaf_to_writes:
                self._words[102] = values[2] if len(values) > 2 else self._words[102]
                self.bench.feed_watchdog()
                return
        super().write(address, values)


class StagedUnit(ModbusUnit):
    """Answers with an exception when told to; what another client writes is not held against the daemon."""

    def __init__(self, device: Device, judge: TimedJudge) -> None:
        super().__init__(device)
        self._judge = judge
        self.refusal: tuple[int, int, int] = (0, 0, 0)  # code, function or 0 for all, how many (-1: all)

    def reply(self, frame: bytes, unit_id: int, transaction_id: int) -> ModbusPDU:
        """Return the answer, or the exception."""
        if frame[0] in (6, 16) and frame[1:3] == b"\0\x64":  # the daemon writes its set point with function 23
            self.device.catch_up()
            self._judge.excused = True
        code, function, count = self.refusal
        if count and function in (0, frame[0]):
            self.refusal = (code, function, count - 1)
            answer = ExceptionResponse(frame[0], code)
            answer.dev_id, answer.transaction_id = unit_id, transaction_id
            return answer
        return super().reply(frame, unit_id, transaction_id)


def lies(kind: str, value: float, count: int) -> Callable[[Sample], Sample]:
    """What a broken load cell, monitor or firmware answers instead.

    Parameters
    ----------
    kind
        Of the lie.
    value
        Its size, in the unit of what it is about.
    count
        Readings that it lasts; 0: for ever.
    """
    told: dict[str, Any] = {"n": 0, "first": None, "begun_ns": time.monotonic_ns()}

    def tell(sample: Sample) -> Sample:
        told["n"] += 1
        if count and told["n"] > count:
            return sample
        told["first"] = told["first"] or sample
        return _LIES[kind](sample, value, told)

    return tell


_LIES: dict[str, Callable[[Sample, float, dict[str, Any]], Sample]] = {
    "force": lambda sample, value, _: replace(sample, force_N=value),
    "offset": lambda sample, value, _: replace(sample, force_N=sample.force_N + value),
    "creep": lambda sample, value, told: replace(
        sample, force_N=sample.force_N + value * 1e-9 * (time.monotonic_ns() - told["begun_ns"])
    ),
    "reversed": lambda sample, _value, _told: replace(sample, force_N=-sample.force_N),
    "gain": lambda sample, value, _: replace(sample, force_N=sample.force_N * value),
    "stuck": lambda sample, _value, told: replace(sample, force_N=told["first"].force_N),
    "frozen": lambda _sample, _value, told: told["first"],
    "heartbeat_back": lambda sample, value, _: replace(sample, heartbeat=(sample.heartbeat - int(value)) & 0xFFFF),
    "gain_creep": lambda sample, value, told: replace(
        sample, force_N=sample.force_N * (1 + value * 1e-9 * (time.monotonic_ns() - told["begun_ns"]))
    ),
    "temperature": lambda sample, value, _: replace(sample, temperature_C=value),
    "readback": lambda sample, value, _: replace(sample, voltage_readback_V=value),
}


class Stage:
    """Device and proxy, and the commands that reach them."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._settings = settings
        scenario = with_effects(load_scenario("stack"), tuple(settings.get("effects", ())))
        self.bench = StagedBench(scenario, seed=1)
        self.bench.warm_up()
        self.bench.judge = self.judge = TimedJudge(*settings["envelope"], self.bench.step_s)
        self.device = StagedDevice(self.bench, Firmware())
        self.unit = StagedUnit(self.device, self.judge)
        self.proxy: TcpProxy | PtyProxy | None = None
        self.behind_s = 0.0  # by so much this process was woken late at most, since the mark

    async def open(self, stack: contextlib.AsyncExitStack) -> dict[str, Any]:
        """Serve; returns where."""
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

    async def obey(self, command: dict[str, Any]) -> dict[str, Any]:
        """Carry out one command."""
        name = command.pop("do")
        return await getattr(self, f"do_{name}")(**command)

    async def do_rules(self, rules: list[dict[str, Any]]) -> dict[str, Any]:
        """Schedule the proxy."""
        self.proxy.schedule([Rule(**rule) for rule in rules])
        return self._now()

    async def do_wire(self, what: str) -> dict[str, Any]:
        """Do something to the connections."""
        await self.proxy.act(what)
        return self._now()

    async def do_lie(self, kind: str = "", value: float | str = 0.0, count: int = 0) -> dict[str, Any]:
        """Lie, or with no kind stop lying; a value may be a word: nan, inf."""
        self.device.lie = lies(kind, float(value), count) if kind else None
        return self._now()

    async def do_refuse(self, code: int, function: int = 0, count: int = -1) -> dict[str, Any]:
        """Answer with exceptions; a count of 0 ends it."""
        self.unit.refusal = (code, function, count)
        return self._now()

    async def do_deaf_to_writes(self, deaf: bool) -> dict[str, Any]:
        """Acknowledge set points without taking them."""
        self.device.deaf_to_writes = deaf
        return self._now()

    async def do_fault_bits(self, bits: int) -> dict[str, Any]:
        """Trip the amplifier: its output falls by itself. Switched on again it begins at rest."""
        self.device.catch_up()
        self.judge.excused = True
        if not bits:
            self.bench._state["command_V"] = 0.0
        self.bench.set_fault(bits)
        return self._now()

    async def do_restart(self) -> dict[str, Any]:
        """Power-on of the firmware. Its connections break first: no request of before reaches what has started anew."""
        await self.proxy.act("reset")
        for _ in range(IN_FLIGHT_TURNS):
            await asyncio.sleep(0)
        self.device.catch_up()
        restart(self.device, self.bench)
        return self._now()

    async def do_second_master(self, above_V: float, times: int, every_s: float) -> dict[str, Any]:
        """Somebody else writes the set point, so far above what stands there."""
        begun = self._now()
        for _ in range(times):
            self.device.catch_up()
            self.judge.excused = True
            words = struct.unpack(">2H", struct.pack(">f", self.device.asked_V + above_V))
            Device.write(self.device, 100, [*words, self.device.command_echo])
            await asyncio.sleep(every_s)
        return begun

    async def do_idle(self, closes_after_s: float) -> dict[str, Any]:
        """Hang up on whoever is silent for so long; 0: never."""
        self.proxy.idle_s = closes_after_s
        return self._now()

    async def do_mark(self) -> dict[str, Any]:
        """Begin to take times anew."""
        self.device.catch_up()
        self.judge.mark()
        self.proxy.done.clear()
        self.proxy.late_s = self.behind_s = 0.0
        self.device.commands = 0
        return self._now()

    async def do_report(self) -> dict[str, Any]:
        """What was seen since the mark; what was wrong since the last report."""
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
            "commands": self.device.commands,
            "watchdog_ms": self.device.watchdog_ms,
            "passed": self.proxy.passed,
            "accepted": getattr(self.proxy, "accepted", 0),
            "done": [asdict(deed) for deed in self.proxy.done[:50]],
            "deeds": len(self.proxy.done),
            "late_ms": 1e3 * self.proxy.late_s,
            "behind_ms": 1e3 * self.behind_s,
        }

    def _now(self) -> dict[str, Any]:
        return {"now_ns": time.monotonic_ns()}

    async def keep_up(self) -> None:
        """Let the physics go on while nobody asks, and see by how much this process is woken late."""
        while True:
            self.device.catch_up()
            begun_s = time.monotonic()
            await asyncio.sleep(BACKGROUND_S)
            self.behind_s = max(self.behind_s, time.monotonic() - begun_s - BACKGROUND_S)


async def _serve(settings: dict[str, Any]) -> None:
    async with contextlib.AsyncExitStack() as stack:
        stage = Stage(settings)
        _say(await stage.open(stack))
        background = asyncio.create_task(stage.keep_up())
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        while line := await reader.readline():
            _say(await stage.obey(json.loads(line)))
        background.cancel()


def _say(answer: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    use_realtime_priority()
    asyncio.run(_serve(json.loads(sys.argv[1])))
