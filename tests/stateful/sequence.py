"""A sequence: how it begins, what its rules do with the service and the device, and how it is judged and ended."""

import contextlib
import socket
import sys
import time

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant

from piezod.daemon.client import Client
from piezod.errors import PiezodError, UnreachableError
from tests.faults.stream_faults import Sender
from tests.stateful.judge import TRIPPED_WITHIN_S, ViolationError
from tests.stateful.service import LiveService

GONE = "gone"
DRIVEN = ("ARMING", "RUNNING", "HOLD", "RAMP_DOWN")
OFF_AT_LEAST_S = 0.02  # four ticks: nobody switches an amplifier on again faster than the service can read its state


class Sequence(RuleBasedStateMachine):
    """One sequence; `service` is set before it runs. The rules are in the classes that inherit."""

    service: LiveService

    @initialize(
        value_N=st.sampled_from([None, 60.0, 120.0, 200.0]),
        idle_clients=st.sampled_from([0, 0, 80]),
        trip_N=st.sampled_from([None, None, 150.0]),
    )
    def begin(self, value_N, idle_clients, trip_N):
        self.bench, self.judge = self.service.bench, self.service.judge
        self.service.sequences += 1
        self.sender, self.clients = Sender(self.service.stream, session=self.service.sequences), []
        self.trip_in_file_N = self.judge.trip_N
        self.judge.begin()
        self.state, self.status, self.tripped, self.steps = "DISARMED", None, False, []
        if idle_clients:
            self._connect(idle_clients, b"")
        if value_N is not None:
            self._arm_and_follow(value_N, 0.3)
        if trip_N is not None:
            self._reload(trip_N)
            self._watch(2.0 * TRIPPED_WITHIN_S)

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

    # actions ----------------------------------------------------------------------------------------------------

    def _arm(self):
        before, report = self.judge.may_drive, self.judge.report()
        self.judge.sent_arm()
        accepted = self._send("arm")
        if accepted:
            self.judge.accepted_arm(report)
        elif accepted is False:
            self.judge.may_drive = before

    def _arm_and_follow(self, value_N, for_s):
        self._stream(value_N)
        time.sleep(0.03)
        self._arm()
        time.sleep(for_s)

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

    def _reload(self, trip_N):
        self.judge.disturb()
        self._write(self.service.text.replace("force_trip_N: 360.0", f"force_trip_N: {trip_N}"))
        self.trip_in_file_N = trip_N
        accepted = self._send("reload")
        if accepted is not False:
            self.judge.trip_N = trip_N if accepted else max(trip_N, self.judge.trip_N)

    def _write(self, text):
        self.bench.path.write_text(text, encoding="utf-8")

    def _stream(self, value_N):
        self.sender.stop()
        self.sender.start(value_N)

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

    def _connect(self, count, sends):
        for _ in range(count):
            client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            client.setblocking(False)
            with contextlib.suppress(OSError):
                client.connect(str(self.bench.folder / "ring.sock"))
                client.send(sends)
            self.clients.append(client)

    def _leave(self):
        for client in self.clients:
            client.close()
        self.clients = []

    def _watch(self, for_s):
        """Judge for a while in which nothing is done."""
        end_s = time.monotonic() + for_s
        while time.monotonic() < end_s:
            self.nothing_wrong_at_the_amplifier()
            time.sleep(0.02)

    # judgement --------------------------------------------------------------------------------------------------

    @invariant()
    def nothing_wrong_at_the_amplifier(self):
        if not hasattr(self, "judge"):
            return
        self.status = None
        if not self._alive():
            self.state = GONE
        else:
            try:
                self.status = self.bench.status()
                self.state = self.status["state"]
            except PiezodError:  # its places are taken
                self.state = None
        self.judge.judge(self.state, self.status)
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
