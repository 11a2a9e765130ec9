"""One history: the service on the simulated machine, what happens to it, and what must always hold."""

import contextlib
import itertools
import json
import math
import os
import re
import signal
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from firmware_sim.firmware.device import IDENTITY
from piezod.config import load_bench
from piezod.control import ROW_DTYPE, RingLog, RingReader, State
from piezod.control.states import DRIVING as DRIVEN
from piezod.daemon.client import Client
from piezod.daemon.run import drive, run_foreground
from piezod.daemon.stop_path import urge
from piezod.errors import PiezodError
from piezod.recorder.messages import MessageReader, Plan, report_sender
from piezod.recorder.ring_recorder import RingRecorder
from piezod.recorder.writer import run as run_recorder
from piezod.session.task import SegmentSpec
from tests.simulation import amplifier as judged
from tests.simulation.amplifier import Amplifier
from tests.simulation.disk import Disk
from tests.simulation.installed import install, new_process_of_the_daemon
from tests.simulation.machine import BOOTED_NS, SECOND, Machine, Process, Thread
from tests.simulation.serial_line import BAUDRATE, make_network
from tests.simulation.sockets import LOOPBACK, Kernel
from tests.simulation.spawning import Spawning
from tests.simulation.trace import Trace

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "config" / "bench.yaml"
PORT = 15020
METRICS_PORT = 19020
SLEW_V_PER_S = 800.0
RAMP_DOWN_V_PER_S = 200.0
COMM_LOSS_S, WATCHDOG_S = 0.4, 0.2
MACHINE_S = 0.3  # for a command on its way through the processes
REST_WITHIN_S = 140.0 / RAMP_DOWN_V_PER_S + COMM_LOSS_S + WATCHDOG_S + MACHINE_S
TRIP_MARGIN_N = 25.0  # noise, and the force that is left on the stack at 0 V
TRIPPED_WITHIN_S = 0.5  # down to `LOW_TRIP_N`; a lower trip needs the ramp from 140 V nearly to its end
PASSED_EACH_PERIOD_N = 100.0  # the sine of 120 +- 40 N is below it for a third of its period at most
EXCEEDED_WITHIN_S = 1.0  # a third of the longest period, 2 s, and the debounce
LOW_TRIP_N, LOW_TRIPPED_WITHIN_S = 100.0, 140.0 / RAMP_DOWN_V_PER_S + 0.1
LOOK_S = 0.02
RECORDED_S = 2.0
TOLD_WITHIN_S = 0.5  # a state that is told was that of a tick so long ago at most; the service looks each 0.1 s
STALE_AFTER_S = 1.0  # values of this age are told as such, by a service that looked `TOLD_WITHIN_S` ago at most
SHOWN_WITHIN_S = 0.1  # an accepted arm is answered some ticks before the log shows its state
WATCHDOG_KNOWN_S = 2.0  # the guard reads it each second; then the ramp down
SENT_EVERY_S = 0.01
ARMING_TIMEOUT_S = 2.0
ARMING_MORE_S = 0.35 + 1.0  # the rise to 140 V at 400 V/s, and checks before it
RESTART_WITHIN_S = 0.3  # 60 ms in the fault list; slow machines among the seeds
RESTORED_WITHIN_S = 3.0  # the service looks for its files each second
FOREIGN_WITHIN_S = 0.1  # the guard compares the set point each 50 ms
DRIFTED = "see piezod diagnose --from-bench"
DRIFT_WINDOW_S = 2.0  # shorter than on a bench, so that a history has several
KEPT_WITHIN_S = 3.0  # from the heat file to the end of a run, which waits 2 s for the reader of its log
SERVICES = ("daemon", "second daemon", "record")
ENDS_WITHIN_S = 15.0  # from SIGTERM to the end of every process of the service
CALM = ("arm", "disarm", "stop", "urge", "reset", "status", "scrape", "stream", "start", "signal_service",
        "kill_service", "disk_fault", "kill_recorder")  # fmt: skip
CALM_AFTER_S = 1.5
STEADY_FROM_V = 10.0
STEADY_SHARE = 0.7  # of the time of the ramp: the reference may fall by 15 V until it begins
STATE_OF_METRICS = re.compile(r'piezod_state\{bench="[^"]*",state="(\w+)"\} 1\.0')
STALE_METRICS = b'piezod_stale{bench="emulator"} 1.0'
TICK, STATE, CAUSE = (ROW_DTYPE.names.index(name) for name in ("tick", "state", "cause"))


class History:
    """A service, its bench and its clients; `run` returns the violations.

    Parameters
    ----------
    plan
        Settings and events.
    folder
        Empty folder, on a file system in memory.
    trace
        Called with each line of the history; None: not traced.
    """

    def __init__(self, plan, folder, trace=None):
        self.plan, self.folder = plan, folder
        self.machine = machine = Machine(plan.seed)
        machine.trace, machine.folder = trace, str(folder)
        machine.least_latency_ns, machine.spread_ns = plan.latency_ns
        self.kernel = Kernel(machine)
        self.spawning = Spawning(machine, self.kernel)
        self.disk = self.kernel.disk = Disk(machine)
        self.spawning.modules["piezod.recorder.writer"] = self.record
        install(machine, self.kernel, self.spawning, folder)
        self.amplifier = Amplifier(
            machine, plan.seed % 97, slew_V_per_s=SLEW_V_PER_S, dt_s=1 / plan.rate_Hz, effects=plan.effects
        )
        self.network = make_network(plan, machine, self.kernel, self.amplifier, folder, PORT)
        self.traces = {}  # of the control processes
        self.network.sees = lambda data, framing: self.trace().send(data, framing)
        append = RingLog.append

        def log(ring_log, *row):
            append(ring_log, *row)
            trace = self.trace()
            trace.add(row[TICK], row[STATE], row[CAUSE])
            trace.judge_authority(row, machine.now_ns)

        RingLog.append = log
        self.path = folder / "bench.yaml"
        self.text = self.write_bench()
        self.service = None
        self.operator = Process(machine, "operator")
        self.operator.start(lambda: machine.sleep(1e6))  # its clients are threads of their own
        self.violations, self.observed = [], {}
        self.rest_due = None
        self.arms = 0  # commands on their way
        self.arms_at_start = False  # as with `piezod run --arm`
        self.last_arm_ns = self.arm_answered_ns = self.wall_stepped_ns = 0
        self.resets, self.pinned = 0, None  # the control process whose fault a refused reset has left
        self.happened = 0  # number of events so far
        self.trip_in_file_N, self.trip_N = 360.0, 360.0
        self.excused = set()
        self.signalled = set()  # services that were told to end
        self.sending_N, self.sequence = None, 0
        self.answers = []
        self.writes = self.reloads = 0
        self.disturbed_until_ns, self.was_disturbed = 0, False
        self.calm_before = True
        self.steady = None  # time [ns], output [V] and reason of a ramp down whose rate is judged
        self.watchdog_known_ns = self.arming_since_ns = 0

    # the bench file -----------------------------------------------------------------------------------------------

    def write_bench(self):
        plan, folder = self.plan, self.folder
        content = yaml.safe_load(BENCH.read_text(encoding="utf-8"))
        for role in ("virtual_time", "virtual_tick_us"):
            del content["link"]["registers"][role]
        reference = {"kind": "sine", "amplitude_N": 40, "offset_N": 120, "frequency_Hz": plan.frequency_Hz}
        if plan.reference == "stream":
            reference = {"kind": "stream", "listen": str(folder / "stream"), "stale_after_s": 0.2,
                         "when_stale": "ramp_down"}  # fmt: skip
        content |= {
            "rate_Hz": plan.rate_Hz,
            "model": str(ROOT / "config" / "model.yaml"),
            "reference": reference,
            "daemon": {"ring_log": str(folder / "ring"), "ring_seconds": 10},
            "real_time": {"fifo_priority": 0, "lock_memory": False, "hold_cpu_latency": False},
            "drift": {"window_s": DRIFT_WINDOW_S} if plan.drift else None,
        }
        if plan.metrics:
            content["daemon"]["metrics_port"] = METRICS_PORT
        if plan.recorder:
            content["recorder"] = {"folder": str(folder / "recordings"), "sync_every_s": 0.5}
        if plan.wire == "rtu":
            kept = {key: content["link"][key] for key in ("registers", "setpoint_readable")}
            content["link"] = kept | {"kind": "modbus_rtu", "baudrate": BAUDRATE}
        port = PORT if plan.wire == "tcp" else str(folder / "serial-by-id")
        content["link"] |= {"timeout_s": 0.8 / plan.rate_Hz, "heartbeat_within_s": 0.005, "port": port}
        content["limits"] |= {
            "comm_loss_ms": round(1e3 * COMM_LOSS_S), "device_watchdog_ms": round(1e3 * WATCHDOG_S),
            "stale_after_ms": 30,
            "slew_V_per_s": SLEW_V_PER_S, "readback_trip_ms": 50, "force_rate_trip_N_per_s": 5000.0,
            "arming_timeout_s": ARMING_TIMEOUT_S, "ramp_down_V_per_s": RAMP_DOWN_V_PER_S,
        }  # fmt: skip
        content["arming"] |= {"reset_cycle": False, "voltage_V_per_s": 400.0}
        content["arming"]["sign_check"] = {"step_V": 2.0, "rise_N": 1.0, "settle_s": 0.05}
        for section, key, value in plan.changes:
            content[section][key] = value
        self.content = content
        for name, file_text in plan.files.items():
            (folder / name).write_text(file_text, encoding="utf-8")
            (folder / name).chmod(0o600)
        limits = content["limits"] | plan.sections.get("limits", {})
        self.arming_within_s = limits["arming_timeout_s"] + ARMING_MORE_S
        text = self.with_sections(plan.sections)
        self.path.write_text(text, encoding="utf-8")
        cold = {"power_W": 0.0, "time_s": 1e-9 * (self.machine.now_ns + self.machine.wall_offset_ns)}
        (folder / "ring.heat").write_text(json.dumps(cold), encoding="ascii")
        return text

    def with_sections(self, sections):
        """Text of the bench file with other sections; a section with a kind is replaced, another one changed."""
        content = dict(self.content)
        for name, value in sections.items():
            whole = not isinstance(value, dict) or "kind" in value
            content[name] = value if whole else content.get(name, {}) | value
        return yaml.safe_dump(content).replace("FOLDER", str(self.folder))

    def write_trip(self, trip_N):
        content = yaml.safe_load(self.text)
        content["limits"]["force_trip_N"] = trip_N
        self._write(yaml.safe_dump(content))
        self.trip_in_file_N = trip_N

    def _write(self, text):
        """Write the bench file; a reload on its way may read the one or the other."""
        self.writes += 1
        self.path.write_text(text, encoding="utf-8")

    # the course ---------------------------------------------------------------------------------------------------

    def run(self):
        """Run to the end of the plan, then end the service; the violations, each (kind, time [s], text)."""
        machine, plan = self.machine, self.plan
        self.start()
        for event in plan.events:
            machine.at(BOOTED_NS + round(event.time_s * SECOND), lambda event=event: self.happen(event))
        machine.after(0, self.look)
        machine.after(0, self.send_on)
        machine.run(BOOTED_NS + round(plan.seconds * SECOND))
        self.finish()
        for name, thread, error in machine.failures:
            self.violations.append(("exception", machine.time_s, f"{name}/{thread}: {type(error).__name__}: {error}"))
        return self.violations

    def finish(self):
        """End the service, and look whether everything has ended."""
        machine = self.machine
        self.heal()
        machine.note("finish")
        if self.alive:
            self.expect_rest("SIGTERM at the end")
        for service in [one for one in machine.processes if one.alive and one.name in SERVICES]:
            service.stopped_until_ns = 0
            if service not in self.signalled:  # a signal of before must be enough
                service.signal(signal.SIGTERM)
        end_ns = machine.now_ns + round(ENDS_WITHIN_S * SECOND)
        while machine.now_ns < end_ns and any(p.alive for p in machine.processes if p is not self.operator):
            machine.run(machine.now_ns + SECOND // 10)
        left = [process.name for process in machine.processes if process.alive and process is not self.operator]
        if left:
            self.violate("end", f"{', '.join(left)} still run {ENDS_WITHIN_S:g} s after the end")
        alarms = [line for process in machine.processes for line in process.log if DRIFTED in line]
        if alarms and not self.was_disturbed:
            self.violate("drift", f"an alarm of a bench that nothing has changed: {alarms[0]}")
        lost, wrong = self.disk.losses(self.folder / "recordings")
        if lost or wrong:
            self.violate(
                "recording", f"acknowledged rows lost, by session: {lost}; rows twice or out of order: {wrong}"
            )
        self.judge()
        self.observed["transitions"] = sum(trace.transitions for trace in self.traces.values())

    @property
    def alive(self):
        return self.service is not None and self.service.alive

    @property
    def control(self):
        """The control process of the present service; None without one."""
        found = [p for p in self.machine.processes if p.alive and p.name == "enter_control_process"]
        return found[-1] if found else None

    def violate(self, kind, text, time_s=None):
        if kind not in {one[0] for one in self.violations}:
            self.violations.append((kind, self.machine.time_s if time_s is None else time_s, text))
            self.machine.note("VIOLATION", kind, text)

    def start(self, arms=None):
        """Start the service, as `piezod run` does, or `piezod run --arm`."""
        if self.alive:
            return
        arms_now = self.arms_at_start if arms is None else arms
        new_process_of_the_daemon()
        self.service = Process(self.machine, "daemon")

        def run():
            self.machine.sleep(self.spawning.start_s())
            self.trip_N = self.trip_in_file_N
            try:
                code = run_foreground(self.path, arm=arms_now).exit_code
                self._judge_heat_kept()
            except PiezodError as error:
                self.machine.note("service", "ends with", error)
                self.answers.append((self.machine.time_s, "run", str(error)))
                code = error.exit_code
            sys.exit(code)

        self.service.start(run)
        if arms:
            self.arm_begins()
            self._arms_itself(self.service)

    def _arms_itself(self, service):
        """The arm of the start is on its way until the service reports it or ends."""
        if service.alive and not any(line.endswith(", armed") for line in service.log):
            self.machine.after(round(LOOK_S * SECOND), lambda: self._arms_itself(service))
        else:
            self.arm_ends("arm")

    def trace(self):
        """Trace of the present process."""
        process = self.machine.process
        if process not in self.traces:
            rate_Hz = self.plan.rate_Hz
            limits = load_bench(self.path).limits
            rates = limits.slew_V_per_s / rate_Hz, limits.ramp_down_V_per_s / rate_Hz, 1e9 / rate_Hz
            self.traces[process] = Trace(lambda text: self.violate("trace", text), *rates, process.received)
        return self.traces[process]

    # what holds ---------------------------------------------------------------------------------------------------

    def look(self):
        self.judge()
        if self.alive and self.control is not None and (self.folder / "ring.heat").exists():
            self.violate("heat", "the heat of an earlier run is still there while the bench is driven: a kill keeps it")
        self.machine.after(round(LOOK_S * SECOND), self.look)

    def _judge_heat_kept(self):
        """A run that ends by itself leaves the heat of the stack, with the time."""
        kept = json.loads((self.folder / "ring.heat").read_text(encoding="ascii"))
        age_s = 1e-9 * (self.machine.now_ns + self.machine.wall_offset_ns) - kept["time_s"]
        stepped = self.machine.now_ns - self.wall_stepped_ns < KEPT_WITHIN_S * SECOND
        if not (0.0 <= kept["power_W"] < math.inf and (stepped or 0.0 <= age_s < KEPT_WITHIN_S)):
            self.violate("heat", f"{kept} was kept {age_s:.3f} s ago")

    def state(self):
        """State in the last row of the control process; None before its first row, and while there is none."""
        rows = None if self.control is None else self._rows(1)
        return None if rows is None else State(int(rows["state"][-1]))

    def _rows(self, most=200):
        """The last rows of the ring log; None where the present control process has written none."""
        try:
            reader = RingReader(self.folder / "ring")
        except PiezodError:
            return None
        waiting = reader.waiting
        if not waiting:
            return None
        reader.seek(max(0, waiting - most))
        rows = reader.read()
        if not rows.size or rows["time_ns"][-1] < self.control.started_ns:  # of a process that was killed
            return None
        return rows

    def judge(self):
        """Judge the physics until now, and what is due."""
        amplifier, machine = self.amplifier, self.machine
        amplifier.catch_up()
        judge = amplifier.judge
        judge[judged.TRIP] = self.trip_N + TRIP_MARGIN_N
        within_s = LOW_TRIPPED_WITHIN_S if self.trip_N < LOW_TRIP_N else TRIPPED_WITHIN_S
        judge[judged.MOST_OVER] = within_s / amplifier.bench.step_s
        at_rest = judge[judged.REST_STEP] >= 0
        judge[judged.JUDGES_FORCE] = float(not self.excused)
        for kind, time_s, text in amplifier.violations():
            if kind == "slew" and "foreign" in self.excused:
                judge[judged.SLEW_STEP] = -1
                judge[judged.RISING] = judge[judged.FALLING] = 0.0
                continue
            if kind == "arm" and "foreign" in self.excused:
                judge[judged.DRIVE_STEP] = -1
                continue
            self.violate(kind, text, time_s)
        shown = machine.now_ns - self.arm_answered_ns > SHOWN_WITHIN_S * SECOND
        may_drive = judge[judged.MAY_DRIVE] or self.excused
        if at_rest and not self.arms and shown and may_drive and self.state() not in DRIVEN:
            judge[judged.MAY_DRIVE] = 0.0
            self.excused -= {"foreign"}
        self._judge_state()
        if self.rest_due is not None:
            due_ns, reason = self.rest_due
            if "writes" in self.excused or "foreign" in self.excused:
                self.rest_due = (machine.now_ns + round(REST_WITHIN_S * SECOND), reason)
            elif at_rest:
                self.rest_due = None
                if self.steady is not None:
                    self._judge_rate()
            elif machine.now_ns > due_ns:
                self.violate("rest", f"output {amplifier.bench.output_V:.2f} V {REST_WITHIN_S:.2f} s after {reason}")
                self.rest_due = None

    def _judge_state(self):
        """ARMING ends by itself, without a reference or with one that is not reached; a fault stays without a reset."""
        if self.pinned is not None and self.pinned is self.control and self.state() is State.DISARMED:
            self.violate("refused", "a reset that was refused has acted")
        now_ns = self.machine.now_ns
        held = self.control is None or self.control.stopped_until_ns or now_ns <= self.machine.stalled_until_ns
        if self.state() is not State.ARMING or held:
            self.arming_since_ns = now_ns
        elif now_ns - self.arming_since_ns > self.arming_within_s * SECOND:
            self.violate("arming", f"ARMING for more than {self.arming_within_s:g} s")

    def expect_rest(self, reason, more_s=0.0):
        if self.rest_due is None:
            self.rest_due = (self.machine.now_ns + round((REST_WITHIN_S + more_s) * SECOND), reason)

    # events -------------------------------------------------------------------------------------------------------

    def happen(self, event):
        self.happened += 1
        self.machine.note("event", event.name, *event.arguments)
        self.calm_before = self.machine.now_ns > self.disturbed_until_ns
        if event.name not in ("status", "scrape", "reset", "heal", "start"):
            self.steady = None
        if event.name == "heal":
            self.disturbed_until_ns = self.machine.now_ns + round(CALM_AFTER_S * SECOND)
        elif event.name == "lost_reply":
            self.disturbed_until_ns = max(self.disturbed_until_ns, self.machine.now_ns + SECOND)
        elif event.name not in CALM:
            self.disturbed_until_ns, self.was_disturbed = math.inf, True
        getattr(self, event.name)(*event.arguments)

    def expect_steadily(self, reason):
        """The ramp down that begins now has the rate of the bench file, where nothing else is wrong."""
        self.amplifier.catch_up()
        calm = self.machine.now_ns > max(self.disturbed_until_ns, self.machine.stalled_until_ns)
        first = self.rest_due is not None and self.rest_due[1] == reason  # no faster stop is on its way
        if calm and first and self.state() is State.RUNNING and self.amplifier.bench.output_V > STEADY_FROM_V:
            self.steady = (self.machine.now_ns, self.amplifier.bench.output_V, reason)

    def _judge_rate(self):
        (sent_ns, from_V, reason), self.steady = self.steady, None
        rest_s = self.amplifier.time_of(self.amplifier.judge[judged.REST_STEP]) - 1e-9 * (sent_ns - BOOTED_NS)
        least_s = STEADY_SHARE * from_V / RAMP_DOWN_V_PER_S
        if rest_s < least_s:
            self.violate("rate", f"{from_V:.1f} V to rest in {rest_s:.3f} s after {reason}, at least {least_s:.3f} s")

    def ask(self, command, sends=None, *, whole=False):
        """A client sends a command; its answer is noted, and `sends` called with whether it was obeyed, and with it."""
        machine = self.machine

        def talk():
            begun_ns = machine.now_ns
            try:
                client = Client(self.folder / "ring.sock")
                try:
                    answer = client.ask(command)
                finally:
                    client.close()
                text, good = str(answer.get("message") or answer.get("state")), True
            except PiezodError as error:
                text, good = f"{type(error).__name__}: {error}", False
            self.arm_ends(command)
            machine.note("answer", command, machine.now_ns - begun_ns, text)
            self.answers.append((machine.time_s, command, text))
            if command == "arm" and not good and not text.startswith("UnreachableError"):
                self._refused_arm(begun_ns)
            if sends is not None:
                sends(good, answer if good and whole else text)

        Thread(self.operator, talk, command)

    def arm(self):
        self.arm_begins()
        self.ask("arm")

    def arm_ends(self, command):
        """The answer to a command has come; that to an arm ends its time on the way."""
        if command == "arm":
            self.arms -= 1
            self.arm_answered_ns = self.machine.now_ns

    def _refused_arm(self, sent_ns):
        """What was refused never acts: from now on only a later arm drives."""
        self.amplifier.catch_up()
        at_rest = self.amplifier.judge[judged.REST_STEP] >= 0
        if self.last_arm_ns <= sent_ns and at_rest and not self.arms and self.state() not in DRIVEN:
            self.amplifier.judge[judged.MAY_DRIVE] = 0.0

    def arm_begins(self):
        """An arm is on its way: from now on the output may drive."""
        self.arms += 1
        self.last_arm_ns = self.machine.now_ns
        self.rest_due = None
        self.amplifier.catch_up()
        self.amplifier.judge[judged.MAY_DRIVE] = 1.0

    def disarm(self):
        self._end("disarm")

    def stop(self):
        self._end("stop")

    def drive_once(self):
        """A command that drives, as `piezod record` does; where a service runs, it is refused."""

        def run():
            self.machine.sleep(self.spawning.start_s())
            ticks = np.arange(round(RECORDED_S * self.plan.rate_Hz)) / self.plan.rate_Hz
            drive_V = SegmentSpec("record", "direct", voltages_V=40.0 * np.sin(np.pi * ticks / RECORDED_S) ** 2)
            try:
                drive(self.path, load_bench(self.path), None, [drive_V], lambda _: None, keeps_rows=False)
            except PiezodError as error:
                self.machine.note("record", "ends with", error)
            finally:
                self.arm_ends("arm")

        self.arm_begins()
        process = Process(self.machine, "record")
        if not self.alive:
            new_process_of_the_daemon()
            self.service = process
        process.start(run)

    def _stops(self, command, *, answered):
        """A stop on its way to the control process that runs, or answered by it."""
        if command == "stop" and self.control in self.traces:
            self.traces[self.control].stop(self.machine.now_ns, answered=answered)

    def _end(self, command):
        if self.alive:
            self.expect_rest(command, self._held_s())
            if command == "disarm":
                self.expect_steadily(command)
        sent_ns = self.machine.now_ns
        self._stops(command, answered=False)
        self.ask(command, lambda good, text: self._ended(command, good, text, sent_ns))

    def _ended(self, command, good, text, sent_ns):
        """A command that did not reach the service asks for nothing; after one that was obeyed no former arm drives."""
        if good:
            self._stops(command, answered=True)
            self.machine.after(round(REST_WITHIN_S * SECOND), lambda: self._stays_at_rest(sent_ns))
        if not good and self.rest_due is not None and self.rest_due[1] == command:
            self.rest_due = None
        if "only stop and disarm are obeyed" in text:
            self.violate("refused", f"{command}: {text}")

    def _held_s(self):
        """Time that processes stand still at least [s]."""
        now_ns = self.machine.now_ns
        held = [self.machine.stalled_until_ns - now_ns]
        return 1e-9 * max(0, *held) + (2.0 if self.alive and self.service.stopped_until_ns else 0.0)

    def _stays_at_rest(self, sent_ns):
        """After a stop that was answered, an arm that was sent before it drives nothing any more."""
        if self.last_arm_ns < sent_ns and not self.excused:
            self.amplifier.catch_up()
            self.amplifier.judge[judged.MAY_DRIVE] = 0.0

    def urge(self, command):
        machine = self.machine
        if self.alive:
            self.expect_rest(f"{command} at the stop socket", self._held_s())

        self._stops(command, answered=False)

        def talk():
            sent_ns, control = machine.now_ns, self.control
            try:
                text = urge(self.folder / "ring.sock.stop", command, 2.0)
                if control is self.control:
                    self._stops(command, answered=text.endswith("passed to the control process"))
                machine.after(round(REST_WITHIN_S * SECOND), lambda: self._stays_at_rest(sent_ns))
            except PiezodError as error:
                text = f"{type(error).__name__}: {error}"
            machine.note("answer", "urge", command, text)

        Thread(self.operator, talk, "urge")

    def reset(self):
        """A reset that is refused leaves the fault as it is."""
        self.resets += 1
        number, self.pinned = self.resets, None

        def refused(good, text):
            if not good and self.resets == number and not text.startswith("Unreach") and self.state() is State.FAULT:
                self.pinned = self.control

        self.ask("reset", refused)

    def status(self):
        def judge(good, text):
            if good:
                self._judge_told(text["state"], is_stale=text["stale"])

        self.ask("status", judge, whole=True)

    def scrape(self, count, kind):
        """Clients of the metrics, most of them impolite; the state that a polite one reads is judged."""
        request = (b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n", b"GET /metrics", b"x" * 20_000, b"")[kind]

        def talk():
            client = self.kernel.socket()
            client.settimeout(2.0)
            answer = b""
            with contextlib.suppress(OSError):
                client.connect((LOOPBACK, METRICS_PORT))
                client.sendall(request)
                while kind == 0 and (data := client.recv(65536)):
                    answer += data
                self.machine.sleep(0.0 if kind == 0 else 1.0)
            client.close()
            self.machine.note("scraped", len(answer))
            told = STATE_OF_METRICS.findall(answer.decode("ascii", "replace"))
            if told:
                self.observed["scraped"] = self.observed.get("scraped", 0) + 1
                self._judge_told(told[0].upper(), is_stale=STALE_METRICS in answer)

        for _ in range(count):
            Thread(self.operator, talk, "scrape")

    def _judge_told(self, name, *, is_stale):
        """The state that a client is told was that of a tick in the last `TOLD_WITHIN_S`, or is told as old."""
        machine, service = self.machine, self.service
        held = machine.now_ns < machine.stalled_until_ns + TOLD_WITHIN_S * SECOND
        if self.control is None or held or not self.alive or service.stopped_until_ns or self.excused & {"row"}:
            return
        rows = self._rows(most=10_000)
        if rows is None or is_stale:
            return
        good_ns = rows["time_ns"][rows["result"] == 0]
        age_s = 1e-9 * (machine.now_ns - int(good_ns[-1])) if good_ns.size else math.inf
        if age_s > STALE_AFTER_S + TOLD_WITHIN_S:
            self.violate("told", f"values {age_s:.2f} s old are told as present ones")
        lately = rows["time_ns"] >= rows["time_ns"][-1] - TOLD_WITHIN_S * SECOND
        states = {State(int(state)).name for state in rows["state"][lately]}
        if name not in states:
            self.violate("told", f"the state is told as {name}, and is {' or '.join(sorted(states))}")

    def reload(self, trip_N, by_signal):
        former_N = self.trip_N if self.state() is State.RUNNING and not self.reloads else -math.inf
        self.trip_N = max(self.trip_N, trip_N)
        self.write_trip(trip_N)
        if by_signal:
            if self.alive and self.service.handlers.get(int(signal.SIGHUP)):
                self.reloads += 1
                self._wait_for_log(self.service, len(self.service.log), self._reloaded(self.writes, former_N))
                self.service.signal(signal.SIGHUP)
        else:
            self.reloads += 1
            self.ask("reload", self._reloaded(self.writes, former_N))

    def _wait_for_log(self, service, begun, sends):
        """The answer to SIGHUP is in the log, behind its first `begun` lines."""
        lines = [line for line in service.log[begun:] if line.startswith("reload")]
        if lines:
            sends(lines[0].startswith("reload: "), lines[0].removeprefix("reload: "))
        elif service.alive:
            self.machine.after(round(LOOK_S * SECOND), lambda: self._wait_for_log(service, begun, sends))
        else:
            self.reloads -= 1

    def _reloaded(self, writes, former_N):
        """What an accepted reload changes: the trip, or an unknown one where the file has changed meanwhile."""
        number = self.happened

        def accept(good, text):
            self.reloads -= 1
            exceeded = self.sending_N is None or self.sending_N > PASSED_EACH_PERIOD_N
            low = exceeded and self.trip_in_file_N <= PASSED_EACH_PERIOD_N
            if good and text == "limits taken" and self.happened == number and low:
                self._expect_state((State.RAMP_DOWN, State.FAULT), EXCEEDED_WITHIN_S, "a trip below the force")
            driven = self.state() is State.RUNNING and self.writes == writes
            if good and text == "limits taken" and driven and -math.inf < former_N < self.trip_in_file_N:
                self.violate(
                    "reload", f"the trip was raised from {former_N:g} to {self.trip_in_file_N:g} N while armed"
                )
            if good and self.trip_N < math.inf:
                self.trip_N = self.trip_in_file_N if self.writes == writes else math.inf

        return accept

    def reload_broken(self, text, by_signal):
        self._write(text)
        writes = self.writes
        if by_signal:
            if self.alive and self.service.handlers.get(int(signal.SIGHUP)):
                self.service.signal(signal.SIGHUP)
        else:
            self.ask("reload", lambda good, _: good and self._accepted(text, writes))
        self.machine.after(SECOND, lambda: self.write_trip(self.trip_in_file_N))

    def _accepted(self, text, writes):
        if self.writes == writes:
            self.violate("reload", f"{text!r} was accepted")
        self.trip_N = math.inf

    def strangers(self, count, kind):
        sends = (b"", b'{"command": "sta', b'{"command": "status"}\n' * 20, b"[" * 3000)[kind]

        def talk():
            with contextlib.suppress(OSError):
                client = self.kernel.socket(1, 1)
                client.settimeout(0.5)
                client.connect(str(self.folder / "ring.sock"))
                client.sendall(sends)
                self.machine.sleep(1.0)
                client.close()

        for _ in range(count):
            Thread(self.operator, talk, "stranger")

    def signal_service(self, name, times):
        """Tell the service to end; SIGTERM ends it also before it has a handler, SIGINT would be an exception then."""
        number = int(getattr(signal, name))
        if self.alive and (name == "SIGTERM" or self.service.handlers.get(number)):
            self.signalled.add(self.service)
            self.expect_rest(name, self._held_s())
            if times == 1:
                self.expect_steadily(name)
                undisturbed = self._is_calm() and self._keeps_up()
                if undisturbed and self.state() in (State.DISARMED, State.ARMING, State.RUNNING):
                    self._expect_no_fault(self.service, self.happened)
            if times > 1:  # the second one is haste
                self._stops("stop", answered=False)
            for _ in range(times):
                if self.alive:
                    self.service.signal(number)

    def _expect_no_fault(self, service, number):
        """A service that a signal ends, and that nothing else happens to, ends with 0."""
        if service.alive and self.happened == number:
            self.machine.after(round(LOOK_S * SECOND), lambda: self._expect_no_fault(service, number))
        elif self.happened == number and service.code:
            self.violate("exit", f"the service ended with {service.code} after a signal")

    def second_service(self):
        """Somebody starts the service once more for the same bench."""
        if not self.alive or any(p.alive and p.name == "second daemon" for p in self.machine.processes):
            return

        def run():
            self.machine.sleep(self.spawning.start_s())
            try:
                code = run_foreground(self.path, arm=False).exit_code
            except PiezodError as error:
                self.machine.note("second service", "ends with", error)
                code = error.exit_code
            sys.exit(code)

        Process(self.machine, "second daemon").start(run)

    def kill_service(self):
        if self.alive:
            self.expect_rest("SIGKILL of the service")
            self.expect_steadily("SIGKILL of the service")
            self.service.signal(signal.SIGKILL)

    def kill_control(self):
        if self.control is not None and "writes" not in self.excused and not self._watchdog_is_new():
            self.expect_rest("SIGKILL of the control process")
            self.control.signal(signal.SIGKILL)

    def _watchdog_is_new(self):
        """Whether the watchdog was changed so lately that nobody can have noticed it."""
        return self.machine.now_ns < self.watchdog_known_ns

    def kill_all(self):
        """Both processes of the service end at once, as in a power cut of the machine."""
        self.expect_rest("SIGKILL of all")
        for process in (self.control, self.service):
            if process is not None and process.alive:
                process.signal(signal.SIGKILL)

    def pause_control(self, for_s):
        if self.control is not None:
            self._pause(self.control, for_s)

    def pause_service(self, for_s):
        if self.alive:
            self._pause(self.service, for_s)

    def _pause(self, process, for_s):
        process.signal(signal.SIGSTOP)
        self.machine.after(round(for_s * SECOND), lambda: process.alive and process.signal(signal.SIGCONT))

    def stall(self, for_s):
        self.machine.stalled_until_ns = max(self.machine.stalled_until_ns, self.machine.now_ns + round(for_s * SECOND))

    def wall_clock(self, by_s):
        self.wall_stepped_ns = self.machine.now_ns
        self.machine.wall_offset_ns += round(by_s * SECOND)

    def false_reading(self, kind, value, count):
        self.excused.add("reading")
        device, seen = self.amplifier.device, itertools.count(1)
        first = device.sample()

        def fault(sample):
            if count and next(seen) > count:
                return sample
            return FALSE[kind](sample, value, first)

        device.reading_fault = fault

    def refusal(self, code, count):
        self.amplifier.refusal = (code, count)

    def ignored_writes(self):
        self.excused |= {"writes", "foreign"}
        self.amplifier.device.ignores_writes = True

    def restart_device(self):
        if self.control is None:
            return  # only the watchdog of the device is left, and it would be lost too
        self._expect_state((State.RAMP_DOWN, State.FAULT), RESTART_WITHIN_S, "the device restarted")
        self.network.reset()
        self.amplifier.device.reading_fault = None
        self.amplifier.device.restart()

    def watchdog(self, milliseconds):
        if self.state() in DRIVEN:
            self.amplifier.catch_up()
            self.amplifier.device.write(110, [milliseconds])
            self.watchdog_known_ns = self.machine.now_ns + round(WATCHDOG_KNOWN_S * SECOND)
            self._expect_state((State.RAMP_DOWN, State.FAULT), WATCHDOG_KNOWN_S, "the watchdog was changed")

    def _expect_state(self, states, within_s, reason):
        """If the bench runs and nothing else is wrong, it is in one of `states` later, unless something happens."""
        if not self._is_calm() or self.state() is not State.RUNNING:
            return
        number = self.happened

        def look():
            found = self.state()
            if self.happened == number and found is not None and found not in states:
                self.violate("state", f"{found.name} {within_s:g} s after {reason}")

        self.machine.after(round(within_s * SECOND), look)

    def _keeps_up(self):
        """Whether the machine misses no tick by itself: a tick waits twice, for its time and for the reply."""
        return 2 * sum(self.plan.latency_ns) < SECOND / self.plan.rate_Hz

    def _is_calm(self):
        return self.calm_before and not self.excused and self.machine.now_ns > self.machine.stalled_until_ns

    def _expect_to_drive_on(self, reason):
        """What follows is no reason for a fault, where there is a reference, and time for each tick."""
        if self._keeps_up() and (self.sending_N is not None or self.plan.reference == "sine"):
            self._expect_state((State.RUNNING,), 0.5, reason)

    def lost_reply(self):
        """One reply is lost: no reason for a fault."""
        self._expect_to_drive_on("one lost reply")
        self.network.rules.append(["drop", "reply", 1, 0.0])

    def exchange_device(self):
        """Another device answers at the same address, on a new connection."""
        if self.control is None:
            return  # only the watchdog of the device is left
        self._expect_state((State.RAMP_DOWN, State.FAULT), 0.5, "another device answers")
        self.excused |= {"writes", "foreign"}
        self.network.reset()
        self.amplifier.device._words[0], self.amplifier.device.is_stranger = 7, True

    def other_master(self, above_V, times):
        if self.state() not in DRIVEN:
            return
        if times * 0.002 > FOREIGN_WITHIN_S:
            self._expect_state((State.RAMP_DOWN, State.FAULT), FOREIGN_WITHIN_S, "the first foreign voltage")
        self.excused.add("foreign")
        for number in range(times):
            self.machine.after(number * 2_000_000, lambda: self.amplifier.device.write_as_other(above_V))

    def trip_amplifier(self):
        self.amplifier.catch_up()
        self.amplifier.judge[judged.EXCUSED] = 1e6
        self.amplifier.bench.set_fault(8)

    def wire(self, fault, way, count, size_ms):
        self.network.rules.append([fault, way, count, size_ms])

    def cut(self, for_s):
        self.network.cut = True
        self.machine.after(round(for_s * SECOND), lambda: setattr(self.network, "cut", False))

    def refuse_connections(self, for_s):
        self.network.refuses = True
        self.network.reset()
        self.machine.after(round(for_s * SECOND), lambda: setattr(self.network, "refuses", False))

    def heal(self):
        """End every fault of device and wire."""
        amplifier, network = self.amplifier, self.network
        network.rules.clear()
        network.cut = network.refuses = False
        self.disk.heal()
        amplifier.refusal = (0, 0)
        amplifier.device._words[0], amplifier.device.is_stranger = IDENTITY, False
        amplifier.device.reading_fault = None
        amplifier.catch_up()
        if amplifier.device.ignores_writes:
            amplifier.device.ignores_writes = False
        if amplifier.bench._state["fault_bits"][0]:
            amplifier.bench._state["command_V"] = 0.0
            amplifier.bench.set_fault(0)
        self.machine.after(SECOND, lambda: self.excused.difference_update({"reading", "writes"}))

    def disk_fault(self, fault, every, for_s):
        self._expect_to_drive_on("a fault of the disk")
        self.disk.strike(fault, every)
        self.machine.after(round(for_s * SECOND), self.disk.heal)

    def kill_recorder(self):
        for process in self.machine.processes:
            if process.name == "writer" and process.alive:
                process.signal(signal.SIGKILL)

    def record(self, plan, reader, writer):
        """The recorder process, as `python -m piezod.recorder.writer` runs it."""
        settings, send = Plan(**plan), report_sender(writer)

        def acknowledge(report):
            self.disk.see(report)
            send(report)

        run_recorder(RingRecorder(settings), MessageReader(reader), acknowledge, settings.sync_every_s)

    def remove_files(self, name):
        if name == "locks":
            for path in (self.folder / "locks").rglob("*"):
                if path.is_file():
                    path.unlink()
            name = "ring.lock"
        service = self.service if self._is_steady(name) and (self.folder / name).exists() else None
        with contextlib.suppress(OSError):
            (self.folder / name).unlink()
        number = self.happened

        def look():
            undisturbed = service is not None and service is self.service and self._is_steady(name)
            if undisturbed and self.happened == number and not (self.folder / name).exists():
                self.violate("files", f"{name} is missing {RESTORED_WITHIN_S:g} s after its removal")

        self.machine.after(round(RESTORED_WITHIN_S * SECOND), look)

    def _is_steady(self, name):
        """Whether the service runs, and nothing holds it; the ring log belongs to its control process."""
        held = self.machine.stalled_until_ns > self.machine.now_ns
        runs = self.alive and self.service not in self.signalled and not self.service.stopped_until_ns
        return runs and not held and (name != "ring" or self.control is not None)

    # the reference ------------------------------------------------------------------------------------------------

    def stream(self, value_N):
        self.sending_N = value_N
        if self.rest_due is not None and self.rest_due[1] == "the end of the reference":
            self.rest_due = None

    def stream_ends(self):
        if self.plan.reference == "stream" and self.sending_N is not None and self.state() in DRIVEN:
            self.expect_rest("the end of the reference", 2.5)  # stale after 0.2 s, or the longest wait of arming
        self.sending_N = None

    def send_on(self):
        if self.sending_N is not None:
            self._datagram(self.sending_N)
        self.machine.after(round(SENT_EVERY_S * SECOND), self.send_on)

    def datagram(self, value_N, sequence):
        if self.rest_due is not None and self.rest_due[1] == "the end of the reference":
            self.rest_due = None
        self._datagram(value_N, None if sequence < 0 else sequence)

    def _datagram(self, value_N, sequence=None):
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        self._deliver(struct.pack("<QQd", sequence, self.machine.now_ns + self.machine.wall_offset_ns, value_N))

    def junk(self, size, times):
        for _ in range(times):
            self._deliver(self.machine.random.randbytes(size))

    def _deliver(self, body):
        with contextlib.suppress(OSError):
            status = os.lstat(self.folder / "stream")
            target = self.kernel.paths.get((status.st_dev, status.st_ino))
            if target is not None:
                target.arrive(body)


FALSE = {
    "force": lambda sample, value, _: replace(sample, force_N=value),
    "offset": lambda sample, value, _: replace(sample, force_N=sample.force_N + value),
    "reversed": lambda sample, _value, _first: replace(sample, force_N=-sample.force_N),
    "gain": lambda sample, value, _: replace(sample, force_N=sample.force_N * value),
    "stuck": lambda sample, _value, first: replace(sample, force_N=first.force_N),
    "frozen": lambda _sample, _value, first: first,
    "heartbeat_stuck": lambda sample, _value, first: replace(sample, heartbeat=first.heartbeat),
    "readback": lambda sample, value, _: replace(sample, voltage_readback_V=value),
    "nan": lambda sample, _value, _first: replace(sample, force_N=math.nan),
}
