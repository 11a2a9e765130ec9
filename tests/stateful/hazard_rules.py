"""What must not delay a stop, take the bench away, blind an interlock, or let an old value pass for a good one.

The classes are those of "Found from outside" in the list of faults: a log or file that stands, removed run-time files,
a model or reading that does not fit the voltage, readings that are wrong now and then, and values that get old.
"""

import contextlib
import fcntl
import os
import signal
import socket
import time
import urllib.request

from hypothesis import strategies as st
from hypothesis.stateful import rule

from piezod.config import load_bench
from piezod.control import CAUSE_TEXT, Cause
from piezod.daemon.stop_path import urge
from piezod.errors import BusyError, PiezodError
from piezod.session.lock import lock_bench
from tests.stateful.device_rules import DeviceRules
from tests.stateful.judge import ViolationError
from tests.stateful.sequence import DRIVEN

WAYS = ("stop", "disarm", "SIGTERM")
LEAST_PIPE_BYTES = 4096
LOGGED_CLIENTS = 160  # lines of 90 bytes fill the pipe and what its reader has taken already
FLOOD_CLIENTS, FLOOD_LINES = 4, 100
MADE_AGAIN_WITHIN_S = 2.5  # the daemon looks once a second
STARTED_WITHIN_S = 10.0
BEYOND_REACH_N = 340.0  # 140 V give 300 N
MADE_STALE_S = 1.6  # stale after 1 s
FORCE_CAUSES = [CAUSE_TEXT[cause] for cause in (Cause.OVER_FORCE, Cause.UNDER_FORCE, Cause.FORCE_RATE)]
SHOWN_S = 0.3  # of it, for the answer


class HazardRules(DeviceRules):
    """Rules of the classes that were found from outside."""

    # a stop while something stands --------------------------------------------------------------------------------

    @rule(way=st.sampled_from(WAYS))
    def log_stands(self, way):
        """Nobody reads stderr, and refused clients fill its pipe."""
        if not self._alive():
            return
        self._did("log stands", way)
        service = self.bench.service
        service.reads.clear()
        try:
            with contextlib.suppress(OSError):
                fcntl.fcntl(service.process.stderr, fcntl.F_SETPIPE_SZ, LEAST_PIPE_BYTES)
            for _ in range(LOGGED_CLIENTS):
                self._client(b"x" * 5000).close()
            self._stop_by(way)
            self._watch(0.3)
        finally:
            service.reads.set()
        self._await_end(way)

    @rule(what=st.sampled_from(["fifo", "/dev/zero"]), way=st.sampled_from(WAYS))
    def reload_hangs(self, what, way):
        """The bench file is no regular file at a reload."""
        if not self._alive():
            return
        self._did(f"reload of {what}", way)
        path = self.bench.path
        path.unlink()
        os.mkfifo(path) if what == "fifo" else path.symlink_to(what)
        client = self._client(b'{"command": "reload"}\n')
        try:
            time.sleep(0.2)
            self._stop_by(way)
            self._watch(0.2)
        finally:
            client.close()
            path.unlink()
            self._write(self.service.text)
            self.trip_in_file_N = 360.0
            self.judge.trip_N = max(self.judge.trip_N, self.trip_in_file_N)  # of a reload that reads it late
        self._await_end(way)

    @rule(way=st.sampled_from(WAYS))
    def flood_of_reloads(self, way):
        """Some clients send one reload after the other."""
        if not self._alive():
            return
        self._did("flood of reloads", way)
        self.judge.disturb()
        self.judge.trip_N = max(self.judge.trip_N, self.trip_in_file_N)
        clients = [self._client(b'{"command": "reload"}\n' * FLOOD_LINES) for _ in range(FLOOD_CLIENTS)]
        time.sleep(0.2)
        self._stop_by(way)
        self._watch(0.2)
        for client in clients:
            client.close()
        self._await_end(way)

    def _client(self, sends):
        client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        client.settimeout(0.5)
        with contextlib.suppress(OSError):
            client.connect(str(self.bench.folder / "ring.sock"))
            client.sendall(sends)
        return client

    def _stop_by(self, way):
        """Stop by the stop socket or a signal, which wait for nothing."""
        if not self._alive():
            return
        self.judge.expect_rest(way, steadily=way != "stop" and self.state == "RUNNING")
        if way == "stop":
            self.judge.disturb()
        if way == "SIGTERM":
            self.bench.service.process.send_signal(signal.SIGTERM)
            return
        begun_s = time.monotonic()
        try:
            urge(self.bench.folder / "ring.sock.stop", way, 2.0)
        except PiezodError as error:
            if self._alive() and self.state in DRIVEN and not self.service.control_killed:
                raise ViolationError(f"{way} in state {self.state} fails: {error}") from error
        self.judge.answered("stop socket", time.monotonic() - begun_s)

    def _await_end(self, way):
        if way == "SIGTERM" and self._alive():
            self.bench.service.process.wait(timeout=30.0)

    # two masters --------------------------------------------------------------------------------------------------

    @rule(names=st.sampled_from([("ring",), ("ring.sock",), ("ring.sock.stop",), ("ring.lock",), "all"]))
    def files_removed(self, names):
        """Somebody removes files of the daemon; a second program must stay out."""
        config = load_bench(self.service.sound_path)
        own = [self.bench.folder / "ring", config.socket_path, config.stop_socket_path, config.lock_path]
        removed = [path for path in own if names == "all" or path.name in names]
        if not self._is_connected() or not removed:
            return
        self._did("removed", *(path.name for path in removed))
        for path in removed:
            path.unlink(missing_ok=True)
        end_s = time.monotonic() + MADE_AGAIN_WITHIN_S
        while not all(path.exists() for path in removed):
            self.nothing_wrong_at_the_amplifier()
            if not self._is_connected():
                return
            if time.monotonic() > end_s:
                missing = [path.name for path in removed if not path.exists()]
                raise ViolationError(f"{missing} not made again within {MADE_AGAIN_WITHIN_S} s, state {self.state}")
            time.sleep(0.05)
        try:
            lock_bench(config).close()
        except BusyError:
            return
        if self._alive():
            raise ViolationError(f"a second program gets the lock of the bench, state {self.state}")

    def _is_connected(self):
        if not self._alive() or self.service.control_killed:
            return False
        try:
            return self.bench.status()["connected"]
        except PiezodError:
            return False

    # what does not fit the voltage: judged by the error that the status shows --------------------------------------

    @rule(reading_N=st.sampled_from([0.0, 100.0]))
    def reading_falls_at_the_rail(self, reading_N):
        """The reference is beyond the reach of the stack; then the cell reads far less."""
        if self.state != "RUNNING":
            return
        self._did("reading falls at the rail", reading_N)
        self.judge.disturb()
        self._stream(BEYOND_REACH_N)
        self._watch(0.5)
        self.judge.excused.add("reading")
        self.bench.device.ask("reading_fault", kind="slides", value=reading_N, count=0)
        self._watch(1.6)

    @rule(value_N=st.sampled_from([60.0, 120.0]))
    def model_of_a_tenth(self, value_N):
        """A model with a tenth of the gain of the bench, that claims to have measured as little."""
        if self.state != "DISARMED":
            return
        self._did("model of a tenth of the gain", value_N)
        self.service.has_foreign_model = True
        self._write(self.service.text_with_tenth)
        accepted = self._send("reload")
        self._write(self.service.text)
        self.trip_in_file_N = 360.0
        self.judge.trip_N = max(self.judge.trip_N, self.trip_in_file_N)
        if not accepted:
            return
        end_s = time.monotonic() + STARTED_WITHIN_S  # the service starts another control process
        while not self._is_connected() and time.monotonic() < end_s:
            self._watch(0.1)
        self._arm_and_follow(value_N, 0.5)
        self._watch(1.2)

    # readings that are wrong now and then -------------------------------------------------------------------------

    @rule(value_N=st.sampled_from([500.0, -100.0]), every=st.sampled_from([2, 3]))
    def force_wrong_at_times(self, value_N, every):
        """Every second or third force is beyond a trip."""
        self._did("force wrong at times", value_N, every)
        self.judge.disturb()
        self.judge.excused.add("reading")
        self.bench.device.ask("reading_fault", kind=f"every_{every}", value=value_N, count=0)
        was_running = self.state == "RUNNING"
        self._watch(1.0)
        if was_running and self.state in ("RUNNING", "HOLD"):
            raise ViolationError(f"state {self.state} after a second with every {every}. force at {value_N} N")
        counts = (self.status or {}).get("interlocks", {}).get("force")
        if counts and self.status["cause"] in FORCE_CAUSES and not counts["wrong"]:
            raise ViolationError(f"{self.status['cause']}, and no wrong sample is counted: {counts}")

    # values that get old ------------------------------------------------------------------------------------------

    @rule()
    def values_get_old(self):
        """The control process stands; status and metrics must say so."""
        if not self._is_connected() or (self.state in DRIVEN and not self._watchdog_is_kept()):
            return
        self._did("control process stands")
        self.judge.disturb()
        pid = self.bench.service.control_pid()
        os.kill(pid, signal.SIGSTOP)
        try:
            self._watch(MADE_STALE_S)
            status = self.bench.status()
            if status["connected"] and not status["stale"]:
                raise ViolationError(f"values of {status['age_s']} s ago are shown as fresh, state {status['state']}")
            shown = self._metric("piezod_stale{")
            if status["connected"] and shown != 1.0:
                raise ViolationError(f"piezod_stale is {shown} while the control process stands")
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        self._watch(SHOWN_S)

    def _metric(self, name):
        """Value of a metric; None without one."""
        line = next((line for _, line in self.bench.service.log_lines if "metrics: http" in line), None)
        if line is None:
            return None
        address = line[line.index("http") :]
        with urllib.request.urlopen(address, timeout=3.0) as answer:  # an address of the loopback interface
            lines = answer.read().decode().splitlines()
        return next((float(line.split()[-1]) for line in lines if line.startswith(name)), None)
