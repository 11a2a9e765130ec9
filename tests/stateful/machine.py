"""The state machine: everything that can happen to a running service, in any order."""

import contextlib
import os
import signal
import socket
import sys
import time
from collections import Counter

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from piezod.control import RingReader
from piezod.daemon.client import Client
from piezod.errors import PiezodError, UnreachableError
from tests.faults.live_bench import LiveBench
from tests.faults.probe import Probe
from tests.faults.running_faults import do
from tests.faults.stream_faults import Sender
from tests.stateful.judge import RAMP_DOWN_V_PER_S, Judge, ViolationError

GONE = "gone"
DRIVEN = ("ARMING", "RUNNING", "HOLD", "RAMP_DOWN")
OFF_AT_LEAST_S = 0.02  # four ticks: nobody switches an amplifier on again faster than the service can read its state
GUARD_PERIOD_S = 0.6  # the watchdog is read at least once in it
RELEASE_WITHIN_S = 10.0  # until a service whose parent was killed has given the device back
BROKEN_FILES = ("", "rate_Hz: [", "schema: piezod.bench/1\nname: x\n", "\x00\xff", "limits: 3\n")
JUNK = (b"", b"x", bytes(24), b"\xff" * 24, bytes(40), b"\xff" * 65000)
EXTREME_N = (0.0, -50.0, 1e300, -1e300, float("nan"), float("inf"))
BENCH = {
    "limits": {"arming_timeout_s": 2.0, "ramp_down_V_per_s": RAMP_DOWN_V_PER_S},
    "reference": {"kind": "stream", "stale_after_s": 0.2, "when_stale": "ramp_down"},
}


class LiveService:
    """The bench that all sequences share, its judge and the sender of its reference."""

    def __init__(self, folder):
        self.probe = Probe()
        stream = folder / "stream"
        self.bench = LiveBench(folder, None, BENCH | {"reference": BENCH["reference"] | {"listen": str(stream)}})
        self.text = self.bench.path.read_text(encoding="utf-8")
        self.stream = stream
        self.bench.restore()
        self.judge = Judge(self.bench, self.probe)
        self.done, self.sequences, self.control_killed = Counter(), 0, False
        self.before = []  # steps of the sequence before

    def anew(self):
        """Restore bench and file; a service that was killed is started again when the device is free.

        A service ends when its control process was killed.
        """
        if self.control_killed:
            self.bench.service.process.wait(timeout=RELEASE_WITHIN_S)
            self.control_killed = False
        self.bench.path.write_text(self.text, encoding="utf-8")
        self.bench.device.ask("idle", closes_after_s=0.0)
        deadline_s = time.monotonic() + RELEASE_WITHIN_S
        while True:
            try:
                self._await_control_process(deadline_s)
                self.bench.restore()
            except AssertionError:
                refused = self.bench.service is None or not self.bench.service.alive
                if not refused or time.monotonic() > deadline_s:
                    raise
                time.sleep(0.1)
            else:
                return

    def _await_control_process(self, deadline_s):
        """Read the ring log of the present control process; an accepted reload has started another."""
        while self.bench.service is not None and self.bench.service.alive and time.monotonic() < deadline_s:
            with contextlib.suppress(PiezodError):
                if self.bench.status()["connected"]:
                    self.bench._ring = RingReader(self.bench.folder / "ring")
                    return
            time.sleep(0.02)

    def close(self):
        self.bench.close()
        self.probe.close()


class ServiceMachine(RuleBasedStateMachine):
    """One sequence; `service` is set before it runs."""

    service: LiveService

    @initialize(value_N=st.sampled_from([None, 60.0, 120.0, 200.0]), idle_clients=st.sampled_from([0, 0, 80]))
    def begin(self, value_N, idle_clients):
        self.bench, self.judge = self.service.bench, self.service.judge
        self.service.sequences += 1
        self.sender, self.clients = Sender(self.service.stream, session=self.service.sequences), []
        self.trip_in_file_N = self.judge.trip_N
        self.judge.begin()
        self.state, self.tripped, self.steps = "DISARMED", False, []
        if idle_clients:
            self.strangers(idle_clients, b"")
        if value_N is not None:
            self.arm_and_follow(value_N, 0.3)

    def _alive(self):
        return self.bench.service is not None and self.bench.service.alive

    def _send(self, command):
        """Whether the service accepted a command; None when it is gone or did not answer."""
        if not self._alive():
            return None
        begun_s = time.monotonic()
        try:
            self.bench.send_command(command)
        except UnreachableError:
            return None
        except PiezodError:
            return False
        finally:
            self.judge.answered(command, time.monotonic() - begun_s)
        return True

    def _did(self, what, *details):
        self.service.done[what] += 1
        self.steps.append(" ".join(map(str, (what, *details))))

    # commands ---------------------------------------------------------------------------------------------------

    @rule()
    def arm(self):
        self._did("arm")
        self._arm()

    @rule(value_N=st.sampled_from([60.0, 120.0, 200.0]), for_s=st.sampled_from([0.15, 0.3, 0.6]))
    def arm_and_follow(self, value_N, for_s):
        """Send a reference, arm, and drive for a while."""
        self._did("arm and follow", value_N, for_s)
        self._stream(value_N)
        time.sleep(0.03)
        self._arm()
        time.sleep(for_s)

    def _arm(self):
        before, report = self.judge.may_drive, self.judge.report()
        self.judge.sent_arm()
        accepted = self._send("arm")
        if accepted:
            self.judge.accepted_arm(report)
        elif accepted is False:
            self.judge.may_drive = before

    @rule(command=st.sampled_from(["disarm", "stop"]))
    def end(self, command):
        self._did(command)
        self._end(command, self._send)

    @rule(command=st.sampled_from(["disarm", "stop"]))
    def end_as_another_client(self, command):
        """End by a client that connects for it, like `piezod stop`."""
        self._did(f"{command} by another client")
        self._end(command, self._send_once)

    def _end(self, command, send):
        if self._alive():
            self.judge.expect_rest(command, steadily=self.state == "RUNNING")
            if command == "stop":
                self.judge.disturb()
            send(command)

    def _send_once(self, command):
        begun_s = time.monotonic()
        try:
            client = Client(self.bench.folder / "ring.sock")
            try:
                client.ask(command)
            finally:
                client.close()
        except PiezodError as error:
            if self._alive() and self.state in DRIVEN and not self.service.control_killed:
                raise ViolationError(f"{command} of another client in state {self.state} fails: {error}") from error
        self.judge.answered(command, time.monotonic() - begun_s)

    @rule()
    def reset(self):
        self._did("reset")
        self._send("reset")

    @rule(trip_N=st.sampled_from([150.0, 250.0, 360.0, 500.0]))
    def reload(self, trip_N):
        self._did("reload", trip_N)
        self.judge.disturb()
        self._write(self.service.text.replace("force_trip_N: 360.0", f"force_trip_N: {trip_N}"))
        self.trip_in_file_N = trip_N
        accepted = self._send("reload")
        if accepted is not False:
            self.judge.trip_N = trip_N if accepted else max(trip_N, self.judge.trip_N)

    @rule(text=st.sampled_from(BROKEN_FILES), by_signal=st.booleans())
    def reload_broken(self, text, by_signal):
        self._did("reload of a broken file", repr(text), by_signal)
        self._write(text)
        if by_signal and self._alive():
            os.kill(self.bench.service.process.pid, signal.SIGHUP)
            time.sleep(0.05)
        elif self._send("reload"):
            raise ViolationError(f"a broken file was accepted: {text!r}")
        self._write(self.service.text)
        self.trip_in_file_N = 360.0

    def _write(self, text):
        self.bench.path.write_text(text, encoding="utf-8")

    @rule(for_ms=st.sampled_from([5, 30, 100, 300]))
    def wait(self, for_ms):
        self._did("wait", for_ms)
        time.sleep(1e-3 * for_ms)

    # processes --------------------------------------------------------------------------------------------------

    @rule(number=st.sampled_from([signal.SIGTERM, signal.SIGINT]), times=st.sampled_from([1, 3]))
    def end_service(self, number, times):
        if not self._alive():
            return
        self._did(f"service {number.name}", times)
        self.judge.expect_rest(number.name, steadily=times == 1 and self.state == "RUNNING")
        for _ in range(times):
            self.bench.service.process.send_signal(number)
        code = self.bench.service.process.wait(timeout=30.0)
        if code < 0 and times == 1:  # a further signal may meet the interpreter's own end
            raise ViolationError(f"the service ended by signal {-code} after {number.name}")

    @rule()
    def kill_service(self):
        if not self._alive():
            return
        self._did("service SIGKILL")
        self.judge.expect_rest("SIGKILL of the service", steadily=self.state == "RUNNING")
        self.bench.service.process.kill()
        self.bench.service.process.wait(timeout=30.0)

    @rule(what=st.sampled_from(["kill", "pause"]), for_s=st.sampled_from([0.05, 0.3]))
    def control_process(self, what, for_s):
        if not self._alive():
            return
        self._did(f"control process {what}", for_s)
        self.judge.disturb()
        with contextlib.suppress(StopIteration, ProcessLookupError):
            pid = self.bench.service.control_pid()
            if what == "kill":
                self.judge.expect_rest("SIGKILL of the control process")
                os.kill(pid, signal.SIGKILL)
                self.service.control_killed = True
            else:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(for_s)
                os.kill(pid, signal.SIGCONT)

    @rule()
    def start_service(self):
        if self._alive():
            return
        self._did("start")
        with contextlib.suppress(AssertionError):  # refused: the device is not free yet
            self.bench.start()
            self.service.control_killed = False
            self.judge.trip_N = self.trip_in_file_N
            self.judge.new_service()

    # references -------------------------------------------------------------------------------------------------

    def _stream(self, value_N):
        self.sender.stop()
        self.sender.start(value_N)

    @rule(value_N=st.sampled_from([60.0, 120.0, 200.0]))
    def stream(self, value_N):
        self._did("stream", value_N)
        self._stream(value_N)

    @rule()
    def stream_ends(self):
        self._did("stream ends")
        self.sender.stop()

    @rule(value_N=st.sampled_from(EXTREME_N), sequence=st.sampled_from([None, 0, 1, 2**64 - 1]))
    def extreme_datagram(self, value_N, sequence):
        self._did("extreme datagram", value_N, sequence)
        other = Sender(self.service.stream, session=self.sender.session)  # the sender's own thread counts on
        other.send(value_N, self.sender.sequence + 1 if sequence is None else sequence)

    @rule(body=st.sampled_from(JUNK), times=st.sampled_from([1, 50]))
    def junk_datagram(self, body, times):
        self._did("junk datagram", len(body), times)
        for _ in range(times):
            self.sender.send_bytes(body)

    @rule(count=st.sampled_from([10, 200]))
    def burst_of_old_values(self, count):
        self._did("burst without a sender", count)
        if self.sender._thread is None:
            for _ in range(count):
                self.sender.send(250.0)

    # the device: after its faults the rate of a ramp is no longer judged ---------------------------------------------

    @rule(
        kind=st.sampled_from(["force", "offset", "reversed", "gain", "stuck", "frozen", "heartbeat_stuck", "readback"]),
        value=st.sampled_from([0.0, 1.0, 30.0, 500.0, "nan"]),
        count=st.sampled_from([1, 3, 0]),
    )
    def false_reading(self, kind, value, count):
        self._did("false reading", kind, value, count)
        self.judge.disturb()
        self.judge.excused.add("reading")
        self.bench.device.ask("reading_fault", kind=kind, value=value, count=count)

    @rule(code=st.sampled_from([1, 2, 4, 6]), count=st.sampled_from([1, 5, 400]))
    def refusal(self, code, count):
        self._did("refusal", code, count)
        self.judge.disturb()
        self.bench.device.ask("refuse", code=code, count=count)

    @rule()
    def ignored_writes(self):
        self._did("ignored writes")
        self.judge.disturb()
        self.judge.excused.add("writes")
        self.bench.device.ask("ignore_writes", ignored=True)

    @rule(what=st.sampled_from(["restart", "lose_settings"]))
    def restart(self, what):
        if self.service.control_killed or not self._alive():
            return  # only the device's watchdog is left, and it would be lost too
        self._did(what)
        self.judge.disturb()
        self.bench.device.ask("reading_fault")  # a firmware that starts anew has no false readings left
        self.bench.device.ask(what)
        time.sleep(GUARD_PERIOD_S)

    @rule(watchdog_ms=st.sampled_from([0, 5000]))
    def foreign_watchdog(self, watchdog_ms):
        if self.state not in DRIVEN or self.service.control_killed or "writes" in self.judge.excused:
            return  # only a service that drives reads the watchdog again, and only a device that obeys takes it
        self._did("foreign watchdog write", watchdog_ms)
        self.judge.disturb()
        do(self.bench, {"write_register": {"address": 110, "value": watchdog_ms}})
        time.sleep(GUARD_PERIOD_S)  # a kill before the next reading of the watchdog leaves the foreign one in force

    @rule(above_V=st.sampled_from([2.0, 4.5]), times=st.sampled_from([1, 20]))
    def second_master(self, above_V, times):
        if self.state not in DRIVEN or self.service.control_killed:
            return  # an output that only another client drives is not the service's
        self._did("second master", above_V, times)
        self.judge.disturb()
        self.judge.excused.add("foreign")
        self.bench.device.ask("second_master", above_V=above_V, times=times, every_s=0.002)

    @rule()
    def amplifier_trips(self):
        self._did("amplifier trips")
        self.judge.disturb()
        self.tripped = True
        self.bench.device.ask("fault_bits", bits=8)

    @rule(
        fault=st.sampled_from(
            ["delay", "drop", "split", "corrupt", "reset", "close", "stall", "lag", "noise", "duplicate"]
        ),
        way=st.sampled_from(["request", "reply"]),
        count=st.sampled_from([1, 10]),
        by=st.sampled_from([0.002, 0.02]),  # a later command is applied late: see "What software cannot protect"
    )
    def wire(self, fault, way, count, by):
        self._did(f"wire {fault}", way, count, by)
        self.judge.disturb()
        self.bench.device.ask("rules", rules=[{"do": fault, "way": way, "count": count, "by": by}])

    @rule()
    def heal(self):
        self._did("heal")
        self._heal()

    def _heal(self):
        self.bench.device.ask("reading_fault")
        self.bench.device.ask("refuse", code=0, count=0)
        self.bench.device.ask("ignore_writes", ignored=False)
        if self.tripped:
            time.sleep(OFF_AT_LEAST_S)
            self.bench.device.ask("fault_bits", bits=0)
            self.tripped = False
        self.bench.device.ask("rules", rules=[])
        if "writes" in self.judge.excused:  # its output jumps to the set point that it ignored, or stays where it is
            self.judge.excused.add("foreign")
            self.judge.rest_due = None  # a service in FAULT writes nothing: `piezod stop --direct` brings it down
        self.judge.excused -= {"reading", "writes"}

    # clients ----------------------------------------------------------------------------------------------------

    @rule(
        count=st.sampled_from([1, 12, 80]),
        sends=st.sampled_from([b"", b'{"command": "sta', b'{"command": "status"}\n' * 20, b"\xff\n" * 20, b"[" * 3000]),
    )
    def strangers(self, count, sends):
        self._did("clients that stay", count, sends[:12])
        for _ in range(count):
            client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            client.setblocking(False)
            with contextlib.suppress(OSError):
                client.connect(str(self.bench.folder / "ring.sock"))
                client.send(sends)
            self.clients.append(client)

    @rule()
    def strangers_leave(self):
        self._did("clients leave")
        self._leave()

    def _leave(self):
        for client in self.clients:
            client.close()
        self.clients = []

    # judgement --------------------------------------------------------------------------------------------------

    @invariant()
    def nothing_wrong_at_the_amplifier(self):
        if not hasattr(self, "judge"):
            return
        if not self._alive():
            self.state = GONE
        else:
            try:
                self.state = self.bench.status()["state"]
            except PiezodError:  # its places are taken
                self.state = None
        self.judge.judge(self.state)
        if self.steps and self.steps[-1] != f"-> {self.state}":
            self.steps.append(f"-> {self.state}")

    def teardown(self):
        if not hasattr(self, "judge"):
            return
        error = sys.exc_info()[1]  # of the step that ends the sequence
        if isinstance(error, Exception):
            self.failed(f"{type(error).__name__}: {error}")
        self.service.before = list(self.steps)
        self.sender.stop()
        self._leave()
        self._heal()
        try:
            if error is None:
                self.end("stop")
            self._await_rest(error)
            self.service.anew()
        except AssertionError as lost:
            self.failed(f"at the end: {lost}")
            raise

    def _await_rest(self, error):
        """Judge on until a rest that is due has come."""
        while error is None and self.judge.waits:
            self.nothing_wrong_at_the_amplifier()
            time.sleep(0.02)

    def failed(self, message):
        """The sequence was violated; its steps are in `steps`."""
