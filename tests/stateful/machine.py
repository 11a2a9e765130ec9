"""The state machine: everything that can happen to a running service, in any order."""

import contextlib
import os
import signal
import time

from hypothesis import strategies as st
from hypothesis.stateful import rule

from tests.faults.stream_faults import Sender
from tests.stateful.hazard_rules import HazardRules
from tests.stateful.judge import ViolationError
from tests.stateful.sequence import DRIVEN

BROKEN_FILES = ("", "rate_Hz: [", "schema: piezod.bench/1\nname: x\n", "\x00\xff", "limits: 3\n")
JUNK = (b"", b"x", bytes(24), b"\xff" * 24, bytes(40), b"\xff" * 65000)
EXTREME_N = (0.0, -50.0, 1e300, -1e300, float("nan"), float("inf"))


class ServiceMachine(HazardRules):
    """Commands, signals and references, the faults of the device, and the hazards that were found from outside."""

    # commands ---------------------------------------------------------------------------------------------------

    @rule()
    def arm(self):
        self._did("arm")
        self._arm()

    @rule(value_N=st.sampled_from([60.0, 120.0, 200.0]), for_s=st.sampled_from([0.15, 0.3, 0.6]))
    def arm_and_follow(self, value_N, for_s):
        """Send a reference, arm, and drive for a while."""
        self._did("arm and follow", value_N, for_s)
        self._arm_and_follow(value_N, for_s)

    @rule(command=st.sampled_from(["disarm", "stop"]))
    def end(self, command):
        self._did(command)
        self._end(command, self._send)

    @rule(command=st.sampled_from(["disarm", "stop"]))
    def end_as_another_client(self, command):
        """End by a client that connects for it, like `piezod stop`."""
        self._did(f"{command} by another client")
        self._end(command, self._send_once)

    @rule()
    def reset(self):
        self._did("reset")
        self._send("reset")

    @rule(trip_N=st.sampled_from([150.0, 250.0, 360.0, 500.0]))
    def reload(self, trip_N):
        self._did("reload", trip_N)
        self._reload(trip_N)

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
        if not self._alive() or (self.state in DRIVEN and not self._watchdog_is_kept()):
            return  # the device's watchdog alone ends what a dead process leaves on
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
