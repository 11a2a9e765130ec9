"""A history with the steps of a row of the fault list, and with the figures that the row bounds."""

import contextlib
import json
import os
import signal
import socket as real_socket
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from firmware_sim.config import Tcp
from piezod.control import RingReader, State
from piezod.daemon.client import Client
from piezod.errors import PiezodError
from piezod.transport import ExchangeResult
from piezod.transport.status import STATUS_WATCHDOG
from tests.faults.forgeries import MARK_N
from tests.faults.running_faults import _longest_gap, _most_in, _ticks_to_command
from tests.simulation import amplifier as judged
from tests.simulation.history import SECOND, History
from tests.simulation.machine import BOOTED_NS, Thread
from tests.simulation.network import TcpConnection
from tests.simulation.row_scripts import SCRIPTS, STREAMED_N
from tests.simulation.sockets import Queue, Stream

SAFE = (State.RAMP_DOWN, State.FAULT)
SAFE_WITHIN_S = 0.201  # from a kill to the ramp of the device
SLOW = 0.4  # of a tick: an exchange that lasts longer is slow
WRITES_EVERY_S = 1e-4  # of a second client that writes without a pause
LIES = {
    "heartbeat_reversed": lambda sample, _value, _s, _first: replace(sample, heartbeat=-sample.heartbeat & 0xFFFF),
    "heartbeat_stuck": lambda sample, _value, _s, first: replace(sample, heartbeat=first.heartbeat),
    "readback_stuck": lambda sample, _value, _s, first: replace(sample, voltage_readback_V=first.voltage_readback_V),
    "gain_creep": lambda sample, value, s, _first: replace(sample, force_N=sample.force_N * (1 + value * s)),
    "temperature": lambda sample, value, _s, _first: replace(sample, temperature_C=value),
    "stuck": lambda sample, _value, _s, first: replace(sample, force_N=first.force_N),
    "offset": lambda sample, value, _s, _first: replace(sample, force_N=sample.force_N + value),
    "force": lambda sample, value, _s, _first: replace(sample, force_N=value),
    "gain": lambda sample, value, _s, _first: replace(sample, force_N=sample.force_N * value),
    "readback": lambda sample, value, _s, _first: replace(sample, voltage_readback_V=value),
}


class Notified(Queue):
    """The socket of systemd: the messages to it."""

    def __init__(self, history):
        super().__init__(history.kernel, None)
        path = history.folder / "notify"
        path.touch()
        status = os.lstat(path)
        history.kernel.paths[status.st_dev, status.st_ino] = self
        os.environ["NOTIFY_SOCKET"] = str(path)
        self.text = ""

    def arrive(self, data):
        self.text += data.decode() + "\n"

    def count(self, word):
        return self.text.count(word)


class RowHistory(History):
    """A history with the steps of a row."""

    def __init__(self, plan, folder, trace=None):
        super().__init__(plan, folder, trace)
        self.observed = {}
        self.fault_ns = 0
        self.commands_before = self.connected_before = 0
        self.safe_in_time = self.refused = 0
        self.clock_jumped_s = 0.0
        self.resumed_commands = self.taken_over_ns = None
        self.from_V = self.killed_ns = 0
        self.client_code = None  # exit code of the client or service whose code the row names
        self.counted = Counter()
        self.notified = Notified(self)
        self.driven_path = folder / "driven.yaml"
        self.driven_path.write_text(self.text, encoding="utf-8")
        if plan.at_start:
            old, new = plan.at_start["edit"]
            assert old is None or old in self.text
            self.path.write_text(self.text if old is None else self.text.replace(old, new), encoding="utf-8")
            self.arms_at_start = plan.at_start["arms"]
            self.steps(plan.at_start["steps"])

    def write_edited(self, old, new):
        """Write the bench file with one text replaced."""
        assert old in self.text, old
        self.path.write_text(self.text.replace(old, new), encoding="utf-8")

    def write_section(self, name, value):
        self.path.write_text(self.with_sections(self.plan.sections | {name: value}), encoding="utf-8")

    def script(self, name, arguments):
        """Run a function of `row_scripts.py`."""
        self.excused.add("row")
        arguments = json.loads(arguments)
        Thread(self.operator, lambda: SCRIPTS[name](self, **arguments), name)

    def mark_fault(self):
        """The fault begins now: times and counts begin."""
        self.fault_ns = self.machine.now_ns
        self.excused.add("row")
        self.amplifier.catch_up()
        self.amplifier.judge[judged.HIGHEST] = 0.0
        self.commands_before, self.connected_before = self.amplifier.device.commands, self.network.connected

    def do_left_behind(self, _):
        """Lock, socket and ring log of an earlier daemon."""
        ring = self.folder / "ring"
        ring.write_bytes(b"PIEZRNG0 of another time" * 10)
        Path(f"{ring}.lock").write_text("1\n", encoding="ascii")
        with contextlib.closing(real_socket.socket(real_socket.AF_UNIX)) as real:
            real.bind(f"{ring}.sock")

    def do_shut(self, door):
        """A closed port, or one that never answers."""
        self.network.refuses = door == "closed"
        self.network.cut = door != "closed"

    def do_other_client(self, _):
        """The device serves one client, and another one is connected."""
        self.amplifier.settings = Tcp(port=self.amplifier.settings.port, one_client=True)
        TcpConnection(self.network, Stream(self.kernel, self.operator))

    def do_hold_port(self, _):
        """Another process holds the port: here the process of the simulation, which the kernel names."""
        self.network.held_by_other = True
        self._held = self.network.path.open("rb")
        self.counted["names_the_holder"] = 0.0

    def steps(self, text):
        self.mark_fault()
        for step in json.loads(text):
            ((name, arguments),) = step.items()
            getattr(self, f"do_{name}")(arguments)

    def do_wire(self, what):
        self.network.reset()
        self.network.refuses = what in ("refuse", "unplug") or (self.network.refuses and what != "plug")
        self._await_take_over()

    def do_replug(self, arguments):
        self.refuse_connections(arguments["after_s"])

    def do_measure_cpu(self, _):
        """Virtual time has no load; `cpu_percent` is a figure of real processes."""

    def do_flap(self, arguments):
        for number in range(arguments["times"]):
            begin_ns = round(number * (arguments["off_s"] + arguments["on_s"]) * SECOND)
            self.machine.after(begin_ns, lambda: self.refuse_connections(arguments["off_s"]))

    def do_rules(self, rules):
        for rule in rules:
            fault = {"random": "garbage", "noise": "noise_around"}.get(rule["do"], rule["do"])
            count = rule.get("count", 1) or 1 << 30
            size = rule.get("kind") or (1e9 / rule["by"] if fault == "throttle" else 1e3 * rule.get("by", 0.0))
            self.wire(fault, rule.get("way", "reply"), count, size)

    def do_refuse(self, arguments):
        self.amplifier.refusal = (arguments["code"], 1 << 30)
        self.network.unit.only = (arguments.get("function", 0), arguments.get("address", -1))

    def do_deaf_to_writes(self, _):
        self.ignored_writes()

    def do_second_master(self, arguments):
        self.excused.add("foreign")
        for number in range(arguments["times"]):
            delay_ns = round(number * arguments["every_s"] * SECOND)
            self.machine.after(delay_ns, lambda: self.amplifier.device.write_as_other(arguments["above_V"]))

    def do_write_beside(self, arguments):
        times = round(arguments["for_s"] / 0.004)
        self.do_second_master({"above_V": arguments["above_V"], "times": times, "every_s": 0.004})

    def do_mark(self, _):
        pass

    def wall_clock(self, by_s):
        super().wall_clock(by_s)
        self.clock_jumped_s = max(self.clock_jumped_s, abs(by_s))

    def do_fault_bits(self, bits):
        self.amplifier.catch_up()
        self.amplifier.judge[judged.EXCUSED] = 1e6
        self.amplifier.bench.set_fault(bits)

    def do_idle(self, closes_after_s):
        self.network.idle_ns = round(closes_after_s * SECOND)
        self.close_idle()

    def close_idle(self):
        for connection in list(self.network.connections):
            if self.machine.now_ns - connection.asked_ns > self.network.idle_ns:
                connection.reset()
        self.machine.after(SECOND // 100, self.close_idle)

    def do_clients(self, arguments):
        sends = "".join(arguments["sends"]).encode() * arguments["repeats"]

        def talk():
            with contextlib.suppress(OSError):
                client = self.kernel.socket(1, 1)
                client.setblocking(False)
                client.connect(str(self.folder / "ring.sock"))
                client.send(sends)
                self.machine.sleep(arguments["for_s"])
                client.close()

        for _ in range(arguments["count"]):
            Thread(self.operator, talk, "client")

    def do_kill(self, _):
        self.kill_all()
        self.machine.after(round(SAFE_WITHIN_S * SECOND), self._look_for_watchdog)

    def _look_for_watchdog(self):
        self.amplifier.catch_up()
        self.safe_in_time += bool(self.amplifier.device.sample().status & STATUS_WATCHDOG)

    def do_kill_parent(self, inject):
        """SIGKILL of the parent, with a command in the pipe of a process that stands, or with further SIGTERM."""
        control = self.control
        self.from_V, self.killed_ns = self.amplifier.bench.output_V, self.machine.now_ns
        if "command" in inject:
            control.signal(signal.SIGSTOP)
            self.ask(inject["command"])
        self.machine.after(SECOND // 20, lambda: self._kill_parent(control, inject))

    def _kill_parent(self, control, inject):
        self.service.signal(signal.SIGKILL)
        for number in range(inject.get("terms", 0)):
            self.machine.after(number * SECOND // 100, lambda: control.alive and control.signal(signal.SIGTERM))
        if "command" in inject:
            control.signal(signal.SIGCONT)

    def do_hold_output(self, _):
        self.rest_due = None

    def begin_stream(self, value_N, sequence):
        self.sequence = sequence
        self.stream(value_N)

    def beside(self, value_N):
        """A datagram of another sender, with the number that comes next."""
        self._datagram(value_N, self.sequence + 1)

    def ask_values(self):
        def talk():
            client = Client(self.folder / "ring.sock")
            values = client.ask("status").get("reference_values") or {}
            client.close()
            self.refused = sum(count for name, count in values.items() if name != "accepted")

        Thread(self.operator, talk, "values")

    def do_other_device(self, arguments):
        if arguments.get("resets"):
            self.network.reset()
        if not arguments.get("keeps_watchdog", True):
            self.amplifier.device.keeps_watchdog = False
        self.amplifier.device.shift = arguments.get("shift", 0)
        for address, word in arguments.get("words", {}).items():
            self.amplifier.device._words[int(address)] = word

    def do_lose_settings(self, _):
        self.network.reset()
        self.amplifier.device.write(110, [0])

    def do_write_register(self, arguments):
        for number in range(round(arguments.get("for_s", 0.0) / WRITES_EVERY_S) + 1):
            self.machine.after(
                round(number * WRITES_EVERY_S * SECOND),
                lambda: self.amplifier.device.write(arguments["address"], [arguments["value"]]),
            )

    def do_lie(self, arguments):
        device, begun_ns, seen = self.amplifier.device, self.machine.now_ns, [0]
        lie, first = LIES[arguments["kind"]], device.sample()

        def fault(sample):
            seen[0] += 1
            if 0 < arguments.get("count", 0) < seen[0]:
                return sample
            elapsed_s = 1e-9 * (self.machine.now_ns - begun_ns)
            return lie(sample, float(arguments.get("value", 0.0)), elapsed_s, first)

        device.reading_fault = fault

    def do_stop_and_go(self, arguments):
        self.pause_control(arguments["for_s"])
        self.machine.after(round(arguments["for_s"] * SECOND) - 1, self._note_commands)

    def _note_commands(self):
        self.resumed_commands = self.amplifier.device.commands

    def _await_take_over(self):
        """Look each millisecond whether the watchdog of the device has tripped."""
        self.amplifier.catch_up()
        if self.amplifier.device.sample().status & STATUS_WATCHDOG:
            self.taken_over_ns = self.machine.now_ns
        elif self.machine.now_ns < self.fault_ns + SECOND:
            self.machine.after(SECOND // 1000, self._await_take_over)

    def do_edit(self, arguments):
        text = self.path.read_text(encoding="utf-8")
        assert arguments["old"] in text
        self.path.write_text(text.replace(arguments["old"], arguments["new"]), encoding="utf-8")
        self.service.signal(signal.SIGHUP)

    def do_restart(self, _):
        self.network.reset()
        self.amplifier.device.restart()

    def observe(self):
        """State, times and counts since the fault, from the ring log."""
        try:
            rows = RingReader(self.folder / "ring").read()
        except PiezodError:
            figures = {"commands": self.amplifier.device.commands, "output_V": abs(self.amplifier.bench.output_V)}
            state = "DISARMED" if "STATUS=DISARMED" in self.notified.text else "none"
            self.observed = {"state": state, "answers": self._answers(), "after_ms": 0.0, "figures": figures}
            return
        after = rows[rows["time_ns"] >= self.fault_ns]
        safe = np.flatnonzero(np.isin(after["state"], SAFE))
        good = rows[(rows["result"] == ExchangeResult.OK)]
        self.observed = {
            "state": State(int(rows["state"][-1])).name,
            "log": "\n".join(line for process in self.machine.processes for line in process.log),
            "answers": self._answers(),
            "after_ms": 1e-6 * (int(after["time_ns"][safe[0]]) - self.fault_ns) + 5.0 if safe.size else 0.0,
            "figures": {
                "failed": int((after["result"] != ExchangeResult.OK).sum()),
                "commands_since": self.amplifier.device.commands - self.commands_before,
                "watchdog_ms": self.amplifier.device.watchdog_ms,
                "commands_to_other": self.amplifier.device.commands - self.commands_before,
                "commands": self.amplifier.device.commands - self.commands_before,
                "highest_V": float(self.amplifier.judge[judged.HIGHEST]),
                "output_V": abs(self.amplifier.bench.output_V),
                "safe_in_time": self.safe_in_time,
                "refused": self.refused,
                "reconnected": self.network.connected - self.connected_before,
                "marked": int((after["force_N"] == MARK_N).sum()),
                "missed": int(after["tick"][-1] - after["tick"][0] + 1 - after.size) if after.size else 0,
                "clock_jumped_s": self.clock_jumped_s,
                "lasted_s": 1e-9 * (self.machine.now_ns - self.fault_ns),
                "reference_off_N": float(np.abs(after["reference_N"] - STREAMED_N).max()) if after.size else 0.0,
            }
            | {result.name.lower(): int((after["result"] == result).sum()) for result in ExchangeResult},
        }
        times_ms, figures = 1e-6 * after["time_ns"], self.observed["figures"]
        if after.size:
            figures["rows_a_tick"] = _most_in(times_ms, 1e3 / self.plan.rate_Hz)
            figures["longest_silence_ms"] = _longest_gap(times_ms[after["result"] == ExchangeResult.OK])
            figures["slow"] = int((after["exchange_ns"] > SLOW * 1e9 / self.plan.rate_Hz).sum())
        if self.resumed_commands is not None:
            figures["commands_afterwards"] = self.amplifier.device.commands - self.resumed_commands
        if self.taken_over_ns is not None:
            figures["device_took_over_ms"] = 1e-6 * (self.taken_over_ns - self.fault_ns)
        if safe.size:
            figures["ticks_to_command"] = _ticks_to_command(after, int(safe[0]))
            safe_ns = int(after["time_ns"][safe[0]])
            before = good[good["time_ns"] < safe_ns]["time_ns"]
            self.observed["figures"]["silence_ms"] = 1e-6 * (safe_ns - int(before[-1])) if before.size else np.inf

    def _answers(self):
        return "\n".join([text for _, _, text in self.answers] + [self.notified.text])

    def finish(self):
        if not self.observed:
            self.observe()
        super().finish()
        self._observe_end()

    def _observe_end(self):
        """What the end of the service adds: its log, its exit code, and when the output was at rest."""
        judge = self.amplifier.judge
        self.observed["log"] = "\n".join(line for process in self.machine.processes for line in process.log)
        self.observed["exit_code"] = self.service.code if self.client_code is None else self.client_code
        self.observed["answers"] = self._answers()
        rest_s = self.amplifier.time_of(judge[judged.REST_STEP])
        figures = self.observed["figures"]
        figures["output_V"] = figures["output_V"] if self.killed_ns == 0 else abs(self.amplifier.bench.output_V)
        if judge[judged.REST_STEP] >= 0:
            figures["rest_ms"] = 1e3 * rest_s - 1e-6 * (self.fault_ns - BOOTED_NS)
            if self.killed_ns:
                figures["ramp_V_per_s"] = self.from_V / (rest_s - 1e-9 * (self.killed_ns - BOOTED_NS))
        figures["exit_code_of_the_service"] = 0.0 if self.arms_at_start else float(self.service.code)
        figures["timeouts"] = self.observed["log"].count("limits.arming_timeout_s")
        figures["lines"] = 1 if self.plan.recorder else self.observed["log"].count("RAILED")
        lost, figures["rows_wrong"] = self.disk.losses(self.folder / "recordings")
        figures["rows_lost"], figures["acknowledged"] = sum(lost.values()), sum(self.disk.acknowledged.values())
        if "recorder goes on" in self.observed["log"]:
            self.observed["answers"] += "\nrecording again"  # the words of the study of the recorder
        figures["tracebacks"] = len(self.machine.failures)
        figures |= self.counted
        if "names_the_holder" in figures:
            figures["names_the_holder"] += f"process {os.getpid()} " in self.observed["answers"]
        figures["processes_left"] = sum(one.alive for one in self.machine.processes if one is not self.operator)
