"""An emulated bench inside the test: its time is turned by hand, its wire has faults, its output is judged.

What is judged is the output of the emulated amplifier, physics step by physics step, never what the daemon believes.
"""

import struct

from pymodbus.framer import FramerSocket

from firmware_sim.config import Firmware
from firmware_sim.firmware.device import Device
from firmware_sim.firmware.modbus import ModbusUnit
from firmware_sim.physics.bench import Bench
from piezod.transport import ExchangeResult
from piezod.transport.bad_exchange import BadExchange
from piezod.transport.frames import classify

MS = 1_000_000
FORCE_AT = 9  # first byte of register 200 in a reply that begins there
STATUS_AT = FORCE_AT + 12  # registers 200 and 206


class HandClock:
    """Deadlines on a time that a test turns; a tick may come late, and those that were missed are skipped."""

    def __init__(self, period_ns):
        self.period_ns = period_ns
        self.time_ns = 10**9
        self.deadline_ns = self.time_ns
        self.late_ns = 0
        self.tick = self.missed = self.missed_in_a_row = self.lateness_ns = 0

    def start(self):
        self.deadline_ns = self.time_ns

    def now_ns(self):
        return self.time_ns

    def time_left_ns(self):
        return self.deadline_ns + self.period_ns - self.time_ns

    def sleep_until_before(self, left_ns):
        self.time_ns = max(self.time_ns, self.deadline_ns + self.period_ns - left_ns)

    def wait(self):
        self.deadline_ns += self.period_ns
        self.tick += 1
        skipped = max(0, -(-(self.time_ns - self.deadline_ns) // self.period_ns))
        self.missed_in_a_row = self.missed_in_a_row + 1 if skipped else 0
        self.missed += skipped
        self.tick += skipped
        self.deadline_ns += skipped * self.period_ns
        self.time_ns = max(self.time_ns, self.deadline_ns + self.late_ns)


class Judge:
    """Says whether the output ever left its range, or moved faster than slew x (time + two ticks).

    Two ticks: one command may come late and the next one on time, and each step is a tick's worth.
    """

    def __init__(self, low_V, high_V, rise_V_per_s, fall_V_per_s, dt_s, step_s):
        self.low_V, self.high_V = low_V - 1e-6, high_V + 1e-6
        self.rise_V, self.fall_V = rise_V_per_s * step_s * 1.12, fall_V_per_s * step_s * 1.12
        self.most_rise_V, self.most_fall_V = 2.02 * rise_V_per_s * dt_s + 1e-6, 2.02 * fall_V_per_s * dt_s + 1e-6
        self.last_V = self.rising_V = self.falling_V = 0.0
        self.excused = False
        self.wrong = []

    def see(self, output_V, step):
        """One physics step."""
        change_V, self.last_V = output_V - self.last_V, output_V
        if not self.low_V <= output_V <= self.high_V:
            self.wrong.append(f"step {step}: output {output_V} V is out of range")
        if self.excused:  # the device moved by itself: it lost its supply
            self.excused = False
            self.rising_V = self.falling_V = 0.0
            return
        self.rising_V = max(0.0, self.rising_V + change_V - self.rise_V)
        self.falling_V = max(0.0, self.falling_V - change_V - self.fall_V)
        if self.rising_V > self.most_rise_V or self.falling_V > self.most_fall_V:
            self.wrong.append(f"step {step}: output moved by {change_V} V to {output_V} V, faster than its slew")


class JudgedBench(Bench):
    """Advances one physics step at a time and shows each output to the judge."""

    judge = None

    def advance_steps(self, steps):
        if self.judge is None:
            super().advance_steps(steps)
            return
        for _ in range(steps):
            super().advance_steps(1)
            self.judge.see(self.output_V, int(self._state["steps"][0]))


class FaultyWire:
    """Carries frames to the emulator's Modbus unit and back; the next exchanges may be made to fail.

    Faults: `lost` (the request), `unanswered` (the device took it), `refused`, `garbled` (the reply), `late` (by some
    milliseconds), and lies about the force.
    """

    framing = "tcp"
    exception_code = stale_bytes = 0
    hint = ""
    description = "wire"
    answered = True

    def __init__(self, device, clock, timeout_ms):
        self.device, self.clock, self.timeout_ns = device, clock, timeout_ms * MS
        self.connected, self.up, self.broken = True, True, False
        self.generation = 1
        self.unit = ModbusUnit(device)
        self.framer = FramerSocket(self.unit.decoder)
        self.faults = []
        self.bad_exchange = BadExchange()
        self.lie = self.status = None
        self.buffer = bytearray(512)
        self.payload = memoryview(self.buffer)

    def open(self):
        self.connected = True

    def close(self):
        self.connected = False

    def ensure_open(self, deadline_s):
        if not self.up:
            return ExchangeResult.DISCONNECTED
        if not self.connected:
            self.connected = True
            self.generation += 1
        return ExchangeResult.OK

    def transact(self, request, deadline_s):
        if self.broken or not self.up or not self.connected:
            self.broken = self.connected = False
            return ExchangeResult.DISCONNECTED
        fault, amount = self.faults.pop(0) if self.faults else ("", 0)
        self.clock.time_ns += MS // 20 + (amount * MS if fault == "late" else 0)
        if fault == "lost":
            return self.time_out()
        if fault == "refused":
            return ExchangeResult.DEVICE_EXCEPTION
        reply = self.answer(bytes(request.frame))
        if fault == "unanswered":
            return self.time_out()
        if fault == "garbled":
            self.connected = False
            return ExchangeResult.MALFORMED
        return self.take(reply, request)

    def answer(self, sent):
        _, unit_id, transaction, frame = self.framer.decode(sent)
        return self.framer.buildFrame(self.unit.reply(frame, unit_id, transaction))

    def take(self, reply, request):
        self.buffer[: len(reply)] = reply
        if len(reply) != request.reply_size or not reply.startswith(bytes(request.reply_head)):
            return classify(self.buffer, request, len(reply))[0]
        if self.lie is not None and request.reads and len(reply) > 30:
            self.buffer[FORCE_AT : FORCE_AT + 4] = struct.pack(">f", self.lie(self.force_N()))
        if self.status is not None and request.reads and len(reply) > 30:
            self.buffer[STATUS_AT : STATUS_AT + 2] = struct.pack(">H", self.status)
        return ExchangeResult.OK

    def force_N(self):
        return struct.unpack(">f", self.buffer[FORCE_AT : FORCE_AT + 4])[0]

    def time_out(self):
        self.clock.time_ns += self.timeout_ns
        self.connected = False
        return ExchangeResult.TIMEOUT


def restart(device, bench):
    """Power-on of the firmware: output and heartbeat at zero, watchdog off."""
    bench.judge.excused = True
    bench.set_voltage(0.0)
    bench.set_watchdog(0.0, safe_V=0.0, ramp_V_per_s=400.0)
    bench._state["samples"] = 0
    device._words[100:103] = [0, 0, 0]
    device._words[110] = 0


def make_device(clock, seed=1):
    """A bench with its firmware, in the time of `clock`."""
    bench = JudgedBench("stack", seed=seed)
    return Device(bench, Firmware(), "real", clock.now_ns), bench
