"""A stop while the daemon's event loop, its log or its files stand still.

Each try starts a service, arms it on a constant reference, applies one blockade, and stops it by `stop`, `disarm` or
SIGTERM in turn. The time counts from the request until the emulated amplifier reads back rest. The limit is the time of
the ramp from the voltage at the request, and half a second.
"""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import yaml

from piezod.daemon.client import command_and_wait
from piezod.errors import PiezodError
from tests.benches.daemon import LONG_LIMITS, register
from tests.benches.emulator import bench_file, emulator
from tests.benches.processes import Popen
from tests.faults.bench_pool import Observation
from tests.faults.live_bench import DAEMON_ROOT

WAYS = ("stop", "disarm", "SIGTERM")
MARGIN_S = 0.5
GIVEN_UP_AFTER_S = 15.0
REST_V = 0.5
READBACK = 202  # register of the emulated bench
FORCE_N = 120.0
SILENT = 300  # more than both sockets serve
FILLING = 1200  # messages of 90 bytes; a pipe holds 65,536 bytes
FILLED_WITHIN_S = 10.0


class Service:
    """A driven bench whose stderr nobody reads."""

    def __init__(self, folder: Path, serves):
        self.serves = serves
        self.bench = bench_file(
            folder,
            serves,
            rate_Hz=200.0,
            limits=LONG_LIMITS,
            reference={"kind": "triangle", "amplitude_N": 1.0, "offset_N": FORCE_N, "frequency_Hz": 0.5},
            model=str(folder / "model.yaml"),
        )
        (folder / "model.yaml").write_bytes((DAEMON_ROOT / "config" / "model.yaml").read_bytes())
        self.socket = folder / "ring.sock"
        command = [sys.executable, "-m", "piezod", "run", str(self.bench)]
        self.process = Popen(command, stderr=subprocess.PIPE, cwd=DAEMON_ROOT)

    def ask(self, command):
        return command_and_wait(self.socket, command, wait=False)

    def drive(self):
        """Arm, and wait until the force is there."""
        deadline_s = time.monotonic() + 60.0
        while time.monotonic() < deadline_s:
            with contextlib.suppress(PiezodError):
                state = self.ask("status")["state"]
                if state == "DISARMED":
                    self.ask("arm")
                if state == "RUNNING" and self.voltage_V() > 20.0:
                    return
            time.sleep(0.1)
        raise RuntimeError("the bench was not driven within a minute")

    def voltage_V(self):
        return register(self.serves, READBACK)

    def send(self, lines):
        """Send lines on a connection of its own and leave it open; answers are not awaited."""
        connection = socket.socket(socket.AF_UNIX)
        connection.settimeout(1.0)
        with contextlib.suppress(OSError):
            connection.connect(str(self.socket))
            connection.sendall(lines)
        return connection

    def close(self):
        children = subprocess.run(
            ["ps", "-o", "pid=", "--ppid", str(self.process.pid)], capture_output=True, text=True, check=False
        ).stdout.split()
        for pid in [*map(int, children), self.process.pid]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()
        self.process.stderr.close()


def log_stands(service):
    """The reader of stderr stands still, and clients with too long lines fill the pipe with messages."""
    begun_s = time.monotonic()
    for _ in range(FILLING):
        service.send(b"x" * 5000).close()
        if time.monotonic() > begun_s + FILLED_WITHIN_S:
            break  # the daemon accepts nobody any more
    return lambda: None


def silent_clients(service):
    """Clients that send nothing hold both sockets of the daemon."""
    paths = [service.socket, service.socket.with_name(service.socket.name + ".stop")]
    clients = [socket.socket(socket.AF_UNIX) for _ in range(SILENT)]
    for k, client in enumerate(clients):
        client.setblocking(False)
        with contextlib.suppress(OSError):
            client.connect(str(paths[k % 2]))
    return lambda: [client.close() for client in clients]


BLOCKADES = {function.__name__: function for function in (log_stands, silent_clients)}


def stop_once(blockade, way):
    """Drive, block, stop, and measure the time until rest, infinite if it never comes; it and its limit [s]."""
    with tempfile.TemporaryDirectory(prefix="piezod-stops-") as name, emulator("--port", "0") as serves:
        service = Service(Path(name), serves)
        try:
            service.drive()
            unblock = BLOCKADES[blockade](service)
            limits = yaml.safe_load((Path(__file__).parents[2] / "config" / "bench.yaml").read_text())["limits"]
            per_s = limits["slew_V_per_s"] if way == "stop" else limits["ramp_down_V_per_s"]
            limit_s = service.voltage_V() / per_s + MARGIN_S
            begun_s = time.monotonic()
            request = threading.Thread(target=_request, args=(service, way), daemon=True)
            request.start()
            took_s = _until_rest(service, begun_s)
            unblock()
            return took_s, limit_s
        finally:
            service.close()


def _request(service, way):
    with contextlib.suppress(PiezodError):
        if way == "SIGTERM":
            service.process.terminate()
        else:
            service.ask(way)


def _until_rest(service, begun_s):
    while (took_s := time.monotonic() - begun_s) < GIVEN_UP_AFTER_S:
        if abs(service.voltage_V()) < REST_V:
            return took_s
        time.sleep(0.005)
    return float("inf")


def blocked(pool, fault, *, blockades, ways=WAYS):
    """Stop a bench of its own in each way under each blockade; the observed time is the longest until rest."""
    tries = [(blockade, way, *stop_once(blockade, way)) for blockade in blockades for way in ways]
    longest_s = max(took_s for _, _, took_s, _ in tries)
    late = [f"{blockade}, {way}: {took_s:.2f} s" for blockade, way, took_s, limit_s in tries if took_s > limit_s]
    observed = Observation("none", text="; ".join(late), after_ms=1e3 * min(longest_s, 1e6))
    observed.figures = {"stops": len(tries), "late": len(late), "never": float(longest_s == float("inf"))}
    return observed


INJECTORS = {"blocked": blocked}
