"""A complete bench of processes: the daemon as a service, the proxy, and an emulated device with a judged output.

One bench serves many faults. After each fault, `LiveBench.restore` ends it, disarms and resets the daemon, and starts a
daemon that has ended.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import yaml

from piezod.control import RingReader, State
from piezod.daemon.client import Client
from piezod.errors import CheckFailedError, UnreachableError
from tests.benches.processes import Popen

ROOT = Path(__file__).parents[2]
DAEMON_ROOT = Path(os.environ.get("PIEZOD_UNDER_TEST", ROOT))  # the checkout whose daemon is tested
BENCH = DAEMON_ROOT / "config" / "bench.yaml"  # with the keys that this daemon knows
WITHIN_S = 30.0  # limit for starting, restoring and ending, which are not measured
ARMING_TRIES = 3
RATE_HZ = 200
TICK_MS = 1000 / RATE_HZ
SLEW_V_PER_S = 800.0
TIMING = {
    "comm_loss_ms": 400,
    "device_watchdog_ms": 200,
    "stale_after_ms": 30,
    "slew_V_per_s": SLEW_V_PER_S,
    "readback_trip_ms": 50,
    "force_rate_trip_N_per_s": 5000.0,
}
REFERENCE = {"kind": "sine", "amplitude_N": 40, "offset_N": 120, "frequency_Hz": 1.0}


class DeviceProcess:
    """The emulated device and the proxy, in a separate process.

    Parameters
    ----------
    settings
        Settings of `tests.faults.emulated_device`.
    prefix
        Command that starts the process, such as `ip netns exec NAME`.
    """

    def __init__(self, settings, prefix=()):
        limits = (0.0, 140.0, SLEW_V_PER_S, SLEW_V_PER_S, 1 / RATE_HZ)
        self.process = Popen(
            [
                *prefix,
                sys.executable,
                "-m",
                "tests.faults.emulated_device",
                json.dumps({"envelope": limits} | settings),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
        )
        self.serves = self._answer()

    def ask(self, do, **arguments):
        self.process.stdin.write(json.dumps({"do": do} | arguments) + "\n")
        self.process.stdin.flush()
        return self._answer()

    def _answer(self):
        line = self.process.stdout.readline()
        if not line:
            raise AssertionError(f"the emulated device ended with {self.process.wait()}")
        return json.loads(line)

    def close(self):
        self.process.stdin.close()
        try:
            self.process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()


class Service:
    """`piezod run`; `log_lines` and `notifications` (to systemd) hold pairs of time [s, monotonic] and text."""

    def __init__(self, path, *arguments, environment=None, prefix=()):
        self.path = path
        self.log_lines, self.notifications = [], []
        self.reads = threading.Event()  # cleared: nobody reads stderr
        self.reads.set()
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        name = f"piezod-faults-{os.getpid()}-{id(self)}"
        self.listener.bind("\0" + name)
        self.begun_s = time.monotonic()
        self.process = Popen(
            [*prefix, sys.executable, "-m", "piezod", "run", str(path), *arguments],
            stderr=subprocess.PIPE,
            text=True,
            cwd=DAEMON_ROOT,  # `python -m` imports from here first
            env=os.environ | {"NOTIFY_SOCKET": "@" + name} | (environment or {}),
        )
        self._threads = [threading.Thread(target=self._listen), threading.Thread(target=self._read)]
        for thread in self._threads:
            thread.start()

    def _listen(self):
        while data := self.listener.recv(4096):
            now_s = time.monotonic()
            self.notifications += [(now_s, line) for line in data.decode().splitlines()]

    def _read(self):
        for line in self.process.stderr:
            self.reads.wait()
            self.log_lines.append((time.monotonic(), line.rstrip("\n")))

    def log(self, since=0):
        """The log lines from index `since` on, as one text."""
        return "\n".join(line for _, line in self.log_lines[since:])

    def status_lines(self):
        return "\n".join(line for _, line in self.notifications)

    def unrequested_armings(self):
        """Number of transitions to ARMING without a command; the two log lines may come in either order."""
        lines = [line for _, line in list(self.log_lines)]
        asked = sum(line.startswith("socket: arm by ") and line.endswith(": arming") for line in lines)
        return max(0, sum(line.startswith("ARMING: ") for line in lines) - asked)

    @property
    def alive(self):
        return self.process.poll() is None

    def wait_for(self, word, within_s=WITHIN_S, since=0):
        """Time of the first log line that contains `word` [s, monotonic]; None after `within_s` without one."""
        deadline_s = time.monotonic() + within_s
        while True:
            alive = self.alive
            for moment_s, line in self.log_lines[since:]:
                if word in line:
                    return moment_s
            if not alive or time.monotonic() > deadline_s:
                return None
            time.sleep(0.005)

    def wait_notification(self, word, within_s=WITHIN_S):
        deadline_s = time.monotonic() + within_s
        while True:
            for moment_s, line in self.notifications:
                if word in line:
                    return moment_s
            if time.monotonic() > deadline_s or not self.alive:
                return None
            time.sleep(0.005)

    def children(self):
        """Command lines of its child processes by process id: control process and multiprocessing tracker."""
        found = subprocess.run(
            ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(self.process.pid)],
            capture_output=True, text=True, check=False,
        ).stdout.splitlines()  # fmt: skip
        return {int(line.split()[0]): line for line in found}

    def control_pid(self):
        """Process id of the control process; a reload of the configuration changes it."""
        return next(pid for pid, line in self.children().items() if "spawn_main" in line)

    def end(self, number=signal.SIGTERM, within_s=WITHIN_S):
        """Send a signal, wait for the end and return the exit code."""
        os.kill(self.process.pid, number)
        return self.process.wait(timeout=within_s)

    def close(self):
        self.reads.set()
        if self.alive:
            children = [pid for pid, line in self.children().items() if "spawn_main" in line]
            for pid in children:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
            self.process.send_signal(signal.SIGCONT)
            self.process.terminate()
            try:
                self.process.wait(timeout=WITHIN_S)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self.listener.shutdown(socket.SHUT_RD)
        for thread in self._threads:
            thread.join(timeout=10)
        self.listener.close()
        self.process.stderr.close()


class LiveBench:
    """Daemon, proxy and device.

    Parameters
    ----------
    folder
        Folder for the files of the bench.
    device_settings
        Settings of `tests.faults.emulated_device`.
    changes
        Sections of the bench file, or single keys of them, with their new values.
    prefix
        Command that starts the device process.
    """

    def __init__(self, folder, device_settings=None, changes=None, prefix=()):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        settings = device_settings or {}
        if settings.get("wire") == "rtu":
            settings = settings | {"link": str(folder / "serial-by-id")}
        self.device = DeviceProcess(settings, prefix)
        self.path = self._bench_file(changes or {})
        self._armings = 0
        self.notes = {}
        self.environment = {}
        self.service = None
        self._client = None
        self._ring = None

    def _bench_file(self, changes):
        content = yaml.safe_load(BENCH.read_text(encoding="utf-8"))
        serves, registers = self.device.serves, content["link"]["registers"]
        if "rtu" in serves:
            content["link"] = {"kind": "modbus_rtu", "port": serves["rtu"], "baudrate": 921600, "registers": registers}
        else:
            host, _, port = serves["tcp"].rpartition(":")
            content["link"] |= {"host": host, "port": int(port)}
        for role in ("virtual_time", "virtual_tick_us"):
            del registers[role]
        content |= {
            "rate_Hz": RATE_HZ,
            "model": str(ROOT / "config" / "model.yaml"),
            "reference": REFERENCE,
            "daemon": {"ring_log": str(self.folder / "ring"), "ring_seconds": 60, "metrics_port": 0},
            "real_time": {"fifo_priority": 80, "lock_memory": False, "hold_cpu_latency": False},
        }
        content["link"] |= {"timeout_s": 0.004, "heartbeat_within_s": 0.005}
        content["limits"] |= TIMING
        content["arming"] |= {"reset_cycle": False, "voltage_V_per_s": 400.0}
        content["arming"]["sign_check"] = {"step_V": 2.0, "rise_N": 1.0, "settle_s": 0.05}
        for section, value in changes.items():
            merged = isinstance(value, dict) and isinstance(content.get(section), dict) and "kind" not in value
            content[section] = content[section] | value if merged else value
        path = self.folder / "bench.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        cold = {"power_W": 0.0, "time_s": time.time()}  # the emulated stack is; of a stack unknown the limit is assumed
        (self.folder / "ring.heat").write_text(json.dumps(cold), encoding="ascii")
        return path

    # the daemon ----------------------------------------------------------------------------------------------------

    def start(self, within_s=WITHIN_S):
        """Start the daemon unless it runs; returns the time until READY [s], of at most `within_s` [s]."""
        if self.service is not None and self.service.alive:
            return None
        self.drop()
        self.service = Service(self.path, environment=self.environment)
        ready_s = self.service.wait_notification("READY=1", within_s)
        if ready_s is None or self.service.wait_for("reading only") is None:
            raise AssertionError(f"the daemon did not start: {self.service.log()}")
        self._ring = RingReader(self.folder / "ring")
        return ready_s - self.service.begun_s

    def drop(self):
        """Close the connections to a daemon that has ended."""
        if self._client is not None:
            self._client.close()
            self._client = None
        service, self.service = self.service, None
        if service is not None:
            service.close()
            self._armings += service.unrequested_armings()

    def send_command(self, command):
        """Send a command over the control socket; reconnects when the daemon has closed it after ten silent seconds."""
        if self._client is None:
            self._client = Client(self.folder / "ring.sock")
        try:
            return self._client.ask(command)
        except UnreachableError:
            self._client.close()
            self._client = Client(self.folder / "ring.sock")
            return self._client.ask(command)

    def status(self):
        return self.send_command("status")

    def wait_state(self, *names, within_s=WITHIN_S):
        deadline_s = time.monotonic() + within_s
        while (state := self.status()["state"]) not in names:
            if time.monotonic() > deadline_s:
                raise AssertionError(f"state is {state}, not {' or '.join(names)}: {self.service.log()[-800:]}")
            time.sleep(0.01)
        return state

    def arm(self, settle_s=0.15):
        """Arm and follow the reference for `settle_s`."""
        for tried in range(ARMING_TRIES):
            try:
                self.send_command("arm")
                break
            except CheckFailedError:  # after a late reply the link rejects the line for a time
                if tried + 1 == ARMING_TRIES:
                    raise
                time.sleep(0.2)
        self.wait_state("RUNNING")
        time.sleep(settle_s)

    @property
    def rearms(self):
        """Number of armings without a command, over all daemons of this bench."""
        return self._armings + (0 if self.service is None else self.service.unrequested_armings())

    def rows(self):
        """Rows of the ring log since the last call."""
        return self._ring.read()

    def restore(self):
        """End every fault, start a daemon that has ended, and wait until the bench is disarmed and at rest."""
        self.device.ask("reading_fault")
        self.device.ask("other_device")
        self.device.ask("rules", rules=[])
        self.device.ask("wire", what="restore")
        self.start()
        self._wait_good()
        state = self.wait_state("FAULT", "DISARMED", "RUNNING", "HOLD")
        if state in ("RUNNING", "HOLD"):
            self.send_command("disarm")
            state = self.wait_state("FAULT", "DISARMED")
        self._wait_rest()
        if state == "FAULT":
            self.send_command("reset")
            self.wait_state("DISARMED")
        self.rows()

    def _wait_good(self):
        """Wait until a row of the ring log holds a good exchange."""
        deadline_s = time.monotonic() + WITHIN_S
        self.rows()
        while True:
            time.sleep(0.02)
            rows = self.rows()
            if rows.size and rows["result"][-1] == 0:
                return
            if time.monotonic() > deadline_s:
                raise AssertionError(f"the device does not answer any more: {self.service.log()[-800:]}")

    def _wait_rest(self):
        deadline_s = time.monotonic() + WITHIN_S
        while abs(self.device.ask("report")["output_V"]) > 0.5:
            if time.monotonic() > deadline_s:
                raise AssertionError("the output does not come to rest")
            time.sleep(0.02)

    def close(self):
        try:
            self.drop()
        finally:
            self.device.close()


def first_row(rows, *states):
    """Index of the first row in one of these states; None when there is none."""
    at = np.flatnonzero(np.isin(rows["state"], [State[name] for name in states]))
    return int(at[0]) if at.size else None


def exchange_end_ns(row):
    """End of the exchange of this row [ns, boot time]."""
    return int(row["time_ns"]) + int(row["exchange_ns"])


def boot_ns(monotonic_ns):
    """Convert a monotonic time to the clock of the ring log, boot time [ns]."""
    return monotonic_ns + time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()
