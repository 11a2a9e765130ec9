"""A whole bench at work: the daemon as a service, the proxy, and an emulated device whose output is judged.

One bench serves many faults: after each it is healed, reset and found disarmed, or started anew where the daemon died.
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
from piezod.errors import CheckFailedError, PiezodError, UnreachableError

ROOT = Path(__file__).parents[2]
BENCH = ROOT / "config" / "bench.yaml"
WITHIN_S = 30.0  # for what is no figure: starting, healing, ending
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


class Stage:
    """The emulated device and the proxy, in a process of their own.

    Parameters
    ----------
    settings
        What `tests.faults.stage` takes.
    prefix
        A command to run it by, such as `ip netns exec`.
    """

    def __init__(self, settings, prefix=()):
        limits = (0.0, 140.0, SLEW_V_PER_S, SLEW_V_PER_S, 1 / RATE_HZ)
        self.process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "tests.faults.stage", json.dumps({"envelope": limits} | settings)],
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
    """`piezod run`; `said` is its log and `told` what systemd heard, with times [s, monotonic]."""

    def __init__(self, path, *arguments, environment=None, prefix=()):
        self.path = path
        self.said, self.told = [], []
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        name = f"piezod-faults-{os.getpid()}-{id(self)}"
        self.listener.bind("\0" + name)
        self.begun_s = time.monotonic()
        self.process = subprocess.Popen(
            [*prefix, sys.executable, "-m", "piezod", "run", str(path), *arguments],
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=os.environ | {"NOTIFY_SOCKET": "@" + name} | (environment or {}),
        )
        self._threads = [threading.Thread(target=self._listen), threading.Thread(target=self._read)]
        for thread in self._threads:
            thread.start()

    def _listen(self):
        while data := self.listener.recv(4096):
            now_s = time.monotonic()
            self.told += [(now_s, line) for line in data.decode().splitlines()]

    def _read(self):
        for line in self.process.stderr:
            self.said.append((time.monotonic(), line.rstrip("\n")))

    def log(self, since=0):
        """Lines said so far, from the `since`-th on."""
        return "\n".join(line for _, line in self.said[since:])

    def status_lines(self):
        return "\n".join(line for _, line in self.told)

    def armings_unasked(self):
        """Transitions to ARMING beyond the commands that were obeyed; either line may come first."""
        lines = [line for _, line in list(self.said)]
        asked = sum(line.startswith("socket: arm by ") and line.endswith(": arming") for line in lines)
        return max(0, sum(line.startswith("ARMING: ") for line in lines) - asked)

    @property
    def alive(self):
        return self.process.poll() is None

    def wait_for(self, word, within_s=WITHIN_S, since=0):
        """When a line with `word` was said [s, monotonic]; None when it was not, in that time."""
        deadline_s = time.monotonic() + within_s
        while True:
            alive = self.alive
            for moment_s, line in self.said[since:]:
                if word in line:
                    return moment_s
            if not alive or time.monotonic() > deadline_s:
                return None
            time.sleep(0.005)

    def wait_told(self, word, within_s=WITHIN_S):
        deadline_s = time.monotonic() + within_s
        while True:
            for moment_s, line in self.told:
                if word in line:
                    return moment_s
            if time.monotonic() > deadline_s or not self.alive:
                return None
            time.sleep(0.005)

    def children(self):
        """Process ids that it started: the one that drives, and multiprocessing's tracker."""
        found = subprocess.run(
            ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(self.process.pid)],
            capture_output=True, text=True, check=False,
        ).stdout.splitlines()  # fmt: skip
        return {int(line.split()[0]): line for line in found}

    def control_pid(self):
        """Of the process that drives; it stays the same until the configuration is reloaded."""
        return next(pid for pid, line in self.children().items() if "spawn_main" in line)

    def end(self, number=signal.SIGTERM, within_s=WITHIN_S):
        """A signal, and the exit code."""
        os.kill(self.process.pid, number)
        return self.process.wait(timeout=within_s)

    def close(self):
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
        For its files.
    stage
        Settings of the stage.
    changes
        Replace sections of the bench file, or single keys of them.
    prefix
        The stage is run by this command.
    """

    def __init__(self, folder, stage=None, changes=None, prefix=()):
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        settings = stage or {}
        if settings.get("wire") == "rtu":
            settings = settings | {"link": str(folder / "serial-by-id")}
        self.stage = Stage(settings, prefix)
        self.path = self._bench_file(changes or {})
        self._armings = 0
        self.noted = {}
        self.environment = {}
        self.service = None
        self._client = None
        self._ring = None

    def _bench_file(self, changes):
        content = yaml.safe_load(BENCH.read_text(encoding="utf-8"))
        serves, registers = self.stage.serves, content["link"]["registers"]
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
        return path

    # the daemon ----------------------------------------------------------------------------------------------------

    def start(self):
        """Start the daemon unless it runs; returns how long until READY [s]."""
        if self.service is not None and self.service.alive:
            return None
        self.drop()
        self.service = Service(self.path, environment=self.environment)
        ready_s = self.service.wait_told("READY=1")
        if ready_s is None or self.service.wait_for("reading only") is None:
            raise AssertionError(f"the daemon did not start: {self.service.log()}")
        self._ring = RingReader(self.folder / "ring")
        return ready_s - self.service.begun_s

    def drop(self):
        """Let go of a daemon that ended."""
        if self._client is not None:
            self._client.close()
            self._client = None
        service, self.service = self.service, None
        if service is not None:
            service.close()
            self._armings += service.armings_unasked()

    def tell(self, command):
        """A command over the socket; the daemon hangs up on whoever was silent for ten seconds."""
        if self._client is None:
            self._client = Client(self.folder / "ring.sock")
        try:
            return self._client.ask(command)
        except UnreachableError:
            self._client.close()
            self._client = Client(self.folder / "ring.sock")
            return self._client.ask(command)

    def status(self):
        return self.tell("status")

    def wait_state(self, *names, within_s=WITHIN_S):
        deadline_s = time.monotonic() + within_s
        while (state := self.status()["state"]) not in names:
            if time.monotonic() > deadline_s:
                raise AssertionError(f"state is {state}, not {' or '.join(names)}: {self.service.log()[-800:]}")
            time.sleep(0.01)
        return state

    def arm(self, settle_s=0.15):
        """Arm and follow the reference for a moment."""
        for tried in range(ARMING_TRIES):
            try:
                self.tell("arm")
                break
            except CheckFailedError:  # a line that was late a moment ago is distrusted for a while
                if tried + 1 == ARMING_TRIES:
                    raise
                time.sleep(0.2)
        self.wait_state("RUNNING")
        time.sleep(settle_s)

    @property
    def rearms(self):
        """Armings that nobody asked for, of every daemon that served this bench."""
        return self._armings + (0 if self.service is None else self.service.armings_unasked())

    def rows(self):
        """Rows of the ring log that were not read yet."""
        return self._ring.read()

    def heal(self):
        """End every fault, and find the bench disarmed and at rest; a daemon that ended is started again."""
        self.stage.ask("lie")
        self.stage.ask("refuse", code=0, count=0)
        self.stage.ask("deaf_to_writes", deaf=False)
        self.stage.ask("fault_bits", bits=0)
        self.stage.ask("rules", rules=[])
        self.stage.ask("wire", what="heal")
        self.start()
        self._wait_good()
        state = self.wait_state("FAULT", "DISARMED", "RUNNING", "HOLD")
        if state in ("RUNNING", "HOLD"):
            self.tell("disarm")
            state = self.wait_state("FAULT", "DISARMED")
        self._wait_rest()
        if state == "FAULT":
            self.tell("reset")
            self.wait_state("DISARMED")
        self.rows()

    def _wait_good(self):
        """Until a row of the ring says that the device answers."""
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
        while abs(self.stage.ask("report")["output_V"]) > 0.5:
            if time.monotonic() > deadline_s:
                raise AssertionError("the output does not come to rest")
            time.sleep(0.02)

    def close(self):
        try:
            self.drop()
        finally:
            self.stage.close()


def first_row(rows, *states):
    """Index of the first row in one of these states; None when there is none."""
    at = np.flatnonzero(np.isin(rows["state"], [State[name] for name in states]))
    return int(at[0]) if at.size else None


def ended_ns(row):
    """When the exchange of this row was judged [ns, boot time]."""
    return int(row["time_ns"]) + int(row["exchange_ns"])


def boot_ns(monotonic_ns):
    """The ring log's clock for a time of the monotonic one [ns]."""
    return monotonic_ns + time.clock_gettime_ns(time.CLOCK_BOOTTIME) - time.monotonic_ns()


__all__ = ["RATE_HZ", "TICK_MS", "TIMING", "LiveBench", "PiezodError", "Service", "Stage"]
