"""The emulated bench in virtual time: firmware and physics of `firmware_sim`, and a judge at every physics step.

The judge is compiled. After each step of 0.1 ms it looks at the output of the amplifier and at the true force. It keeps
the first violation of each kind.
"""

import struct

import numpy as np
from numba import njit

from firmware_sim.config import Firmware, Tcp
from firmware_sim.firmware.device import Device
from firmware_sim.firmware.modbus import ModbusUnit
from firmware_sim.physics.bench import Bench
from firmware_sim.physics.kernels import advance
from firmware_sim.physics.scenario import load_scenario, with_effects

REST_V = 0.5  # largest output that counts as rest
FIELDS = (
    "low_V", "high_V", "rise_V", "fall_V", "most_rise_V", "most_fall_V",  # the envelope, for each step
    "last_V", "rising_V", "falling_V", "excused",
    "may_drive", "trip_N", "over_steps", "most_over_steps", "judges_force",
    "highest_V", "rest_step", "active_step", "highest_N",  # since the last mark
    "range_step", "range_V", "slew_step", "slew_V", "drive_step", "drive_V", "trip_step", "trip_force_N",
)  # fmt: skip
AT = {name: number for number, name in enumerate(FIELDS)}
(LOW, HIGH, RISE, FALL, MOST_RISE, MOST_FALL, LAST, RISING, FALLING, EXCUSED, MAY_DRIVE, TRIP, OVER, MOST_OVER,
 JUDGES_FORCE, HIGHEST, REST_STEP, ACTIVE_STEP, HIGHEST_N, RANGE_STEP, RANGE_V, SLEW_STEP, SLEW_V, DRIVE_STEP, DRIVE_V,
 TRIP_STEP, TRIP_FORCE) = range(len(FIELDS))  # fmt: skip
SHORT = 0.5  # of a tick: two commands so near to each other follow a late tick
MOST_SHORT = 3  # such intervals in a row: ticks that were missed are made up for
LEEWAY = 1.12  # of the slew of one step: the converter of the device steps at its own rate


@njit(cache=True)
def advance_judged(states, parameters, steps, judge):  # one compiled loop
    """Advance by a number of steps, and judge the output after each."""
    for _ in range(steps):
        advance(states, parameters, 1)
        state = states[0]
        output, force, step = state.output_V, state.true_force_N, state.steps
        change = output - judge[LAST]
        judge[LAST] = output
        if not judge[LOW] <= output <= judge[HIGH] and judge[RANGE_STEP] < 0:
            judge[RANGE_STEP], judge[RANGE_V] = step, output
        if judge[EXCUSED] > 0:
            judge[RISING] = judge[FALLING] = 0.0
            if abs(change) > 1e-9:
                judge[EXCUSED] -= 1
        else:
            judge[RISING] = max(0.0, judge[RISING] + change - judge[RISE])
            judge[FALLING] = max(0.0, judge[FALLING] - change - judge[FALL])
            if (judge[RISING] > judge[MOST_RISE] or judge[FALLING] > judge[MOST_FALL]) and judge[SLEW_STEP] < 0:
                judge[SLEW_STEP], judge[SLEW_V] = step, change
        judge[HIGHEST], judge[HIGHEST_N] = max(judge[HIGHEST], output), max(judge[HIGHEST_N], force)
        if abs(output) <= REST_V:
            if judge[REST_STEP] < 0:
                judge[REST_STEP] = step
        else:
            judge[ACTIVE_STEP] = step
            judge[REST_STEP] = -1
            if judge[MAY_DRIVE] == 0 and judge[DRIVE_STEP] < 0:
                judge[DRIVE_STEP], judge[DRIVE_V] = step, output
        judge[OVER] = judge[OVER] + 1 if force > judge[TRIP] and judge[JUDGES_FORCE] > 0 else 0.0
        if judge[OVER] > judge[MOST_OVER] and judge[TRIP_STEP] < 0:
            judge[TRIP_STEP], judge[TRIP_FORCE] = step, force


class JudgedBench(Bench):
    """Physics whose output is judged."""

    def judge_by(self, low_V, high_V, slew_V_per_s, dt_s):
        step_s = self.step_s
        self.judge = np.zeros(len(FIELDS))
        self.judge[:6] = (
            low_V - 1e-6, high_V + 1e-6, slew_V_per_s * step_s * LEEWAY, slew_V_per_s * step_s * LEEWAY,
            2.02 * slew_V_per_s * dt_s + 1e-6, 2.02 * slew_V_per_s * dt_s + 1e-6,
        )  # fmt: skip
        self.judge[[RANGE_STEP, SLEW_STEP, DRIVE_STEP, TRIP_STEP]] = -1
        self.judge[[TRIP, MOST_OVER]] = np.inf

    def advance_steps(self, steps):
        if steps > 0 and hasattr(self, "judge"):
            advance_judged(self._state, self._parameters, steps, self.judge)
        elif steps > 0:
            super().advance_steps(steps)


class SimDevice(Device):
    """The firmware, with false readings and refused writes."""

    def __init__(self, bench, now_ns):
        self.reading_fault = None
        self.ignores_writes = False
        self.keeps_watchdog = True
        self.commands = 0
        self.command_ns = 0
        self.dt_ns, self.short, self.bursts = 0, 0, 0
        self.is_stranger, self.to_stranger = False, 0  # another device on a new connection, and commands to it
        self.requested_V = 0.0
        self.range_V = (0.0, 140.0)
        self.outside = 0  # commands outside of it
        self.masters, self.sender, self.alternations = [], None, 0  # services in the order of their commands
        self.shift = 0  # registers by which a changed map is shifted
        super().__init__(bench, Firmware(), "real", now_ns)

    def sample(self):
        sample = super().sample()
        return sample if self.reading_fault is None else self.reading_fault(sample)

    def read(self, address, count):
        return super().read(address + self.shift, count)

    def write(self, address, values):
        address += self.shift
        if address == 100:
            self.commands += 1
            now_ns = self._now_ns()
            self.short = self.short + 1 if now_ns - self.command_ns < SHORT * self.dt_ns else 0
            self.bursts += self.short == MOST_SHORT
            self.command_ns = now_ns
            self.to_stranger += self.is_stranger
            self.requested_V = struct.unpack(">f", struct.pack(">2H", *values[:2]))[0]
            low_V, high_V = self.range_V
            self.outside += not low_V - 1e-4 <= self.requested_V <= high_V + 1e-4
            self._note_master()
            if self.ignores_writes:
                self.catch_up()
                self._words[102] = values[2] if len(values) > 2 else self._words[102]
                self.bench.feed_watchdog()
                return
        if address == 110 and not self.keeps_watchdog:
            return
        super().write(address, values)

    def _note_master(self):
        """Two services that command in turn are two masters; one that follows another is none."""
        if self.masters and self.masters[-1] == self.sender:
            return
        self.alternations += self.sender in self.masters
        self.masters.append(self.sender)

    def restart(self):
        """Power-on of the firmware: output and heartbeat at zero, watchdog off."""
        self.catch_up()
        self.bench.judge[EXCUSED] = 1.0
        self.bench.set_voltage(0.0)
        self.bench.set_watchdog(0.0, safe_V=0.0, ramp_V_per_s=400.0)
        self.bench._state["samples"] = 0
        self._words[100:103] = [0, 0, 0]
        self._words[110] = 0

    def write_as_other(self, above_V):
        """Another client writes the set point."""
        self.catch_up()
        words = struct.unpack(">2H", struct.pack(">f", min(139.0, max(0.0, self.requested_V + above_V))))
        super().write(100, [*words, self.command_echo])


class Amplifier:
    """Device, its Modbus unit and its judge."""

    def __init__(self, machine, seed, *, slew_V_per_s, dt_s, effects=()):
        self._machine = machine
        self.bench = JudgedBench(with_effects(load_scenario("stack"), effects), seed=seed)
        self.bench.judge_by(0.0, 140.0, slew_V_per_s, dt_s)
        self.device = SimDevice(self.bench, lambda: machine.now_ns)
        self.device.dt_ns = round(1e9 * dt_s)
        self._start_ns = machine.now_ns
        self.unit = ModbusUnit(self.device)
        self.settings = Tcp(port=15020)
        self.refusal = (0, 0)  # exception code, number of requests

    @property
    def judge(self):
        return self.bench.judge

    def catch_up(self):
        self.device.catch_up()

    def time_of(self, step):
        """Virtual time of a physics step since the start [s]."""
        return step * self.bench.step_s

    def violations(self):
        """Texts of what the judge found, each kind once."""
        judge, device = self.bench.judge, self.device
        counts = (
            ("burst", device.bursts, f"times {MOST_SHORT + 1} commands within {SHORT * MOST_SHORT:g} ticks"),
            ("range", device.outside, f"commands outside {device.range_V} V"),
            ("masters", device.alternations, "times two services command the device in turn"),
            ("stranger", device.to_stranger, "commands to another device"),
        )
        found = [(kind, self._machine.time_s, f"{count} {text}") for kind, count, text in counts if count]
        for kind, at, value, text in (
            ("range", RANGE_STEP, RANGE_V, "output {:.3f} V out of its range"),
            ("slew", SLEW_STEP, SLEW_V, "output faster than its slew, by {:.3f} V in a step"),
            ("arm", DRIVE_STEP, DRIVE_V, "output {:.3f} V without an accepted arm"),
            ("trip", TRIP_STEP, TRIP_FORCE, "force {:.1f} N above the acknowledged trip for too long"),
        ):
            if judge[at] >= 0:
                found.append((kind, self.time_of(judge[at]), text.format(judge[value])))
        return found
