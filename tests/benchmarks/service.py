"""The service: from a start to READY and disarmed, after a kill while it was driving, and from SIGTERM to its end.

The limit of a start is an interpreter that only imports what the control process cannot do without.
"""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import yaml

from piezod.commissioning.shipped_files import shipped
from piezod.daemon.client import Client
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.table import NotMeasuredError, Row

ROUNDS = 10
MOST_START_MS = 2000.0
WITHIN_S = 30.0
PATIENCE = {"comm_loss_ms": 2000, "device_watchdog_ms": 1000, "missed_ticks_in_a_row": 500}


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows of start and stop, and the lower limit of a start."""
    rounds = 2 if quick else ROUNDS
    with tempfile.TemporaryDirectory() as name, peers.emulator("tcp", "real") as address:
        bench = bench_file(Path(name), address)
        ready_ms, stop_ms, limit_ms = [], [], []
        _kill_while_driving(bench)
        for _ in range(rounds):
            begun_s = time.monotonic()
            with started(bench) as (process, client):
                ready_ms.append(1e3 * (time.monotonic() - begun_s))
                _require(client.ask("status")["state"], "DISARMED", "after the start")
                arm(client)
                begun_s = time.monotonic()
                process.terminate()
                _require(process.wait(WITHIN_S), 0, "as exit code")
                stop_ms.append(1e3 * (time.monotonic() - begun_s))
            _kill_while_driving(bench)
            limit_ms.append(_imports_ms())
    spread = f"{rounds} starts, each after a kill while driving: {min(ready_ms):.0f} to {max(ready_ms):.0f} ms"
    yield Row(
        "service",
        "start to READY and disarmed",
        "ms",
        float(np.median(ready_ms)),
        float(np.median(limit_ms)),
        "importing numba, pymodbus, pydantic",
        most=MOST_START_MS,
        note=spread,
    )
    yield Row("service", "SIGTERM while driving to the end", "ms", float(np.median(stop_ms)), note="with its ramp down")


def bench_file(folder: Path, address: peers.Address, rate_Hz: float = 1000.0) -> Path:
    content = yaml.safe_load(shipped("bench.yaml").read_text(encoding="utf-8"))
    content["rate_Hz"] = rate_Hz
    content["link"] |= {"host": address.host, "port": address.port, "timeout_s": 0.5}
    content["limits"] |= PATIENCE | {"stale_after_ms": max(5.0, 4e3 / rate_Hz)}
    content["arming"] |= {"reset_cycle": False}
    content["model"] = str(shipped("model.yaml"))
    content["daemon"] = {"ring_log": str(folder / "ring")}
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@contextlib.contextmanager
def started(bench: Path) -> Iterator[tuple[subprocess.Popen[bytes], Client]]:
    """A service after READY, and a client connected to it."""
    name = f"\0piezod-benchmark-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(name)
        listener.settimeout(WITHIN_S)
        process = subprocess.Popen(
            [sys.executable, "-m", "piezod", "run", str(bench)],
            stderr=subprocess.DEVNULL,
            env=os.environ | {"NOTIFY_SOCKET": "@" + name[1:]},
        )
        try:
            while b"READY=1" not in listener.recv(4096):
                pass
            client = Client(bench.parent / "ring.sock")
            yield process, client
            client.close()
        finally:
            process.kill()
            process.wait()


def arm(client: Client) -> None:
    client.ask("arm")
    _require(client.wait_until_settled()["state"], "RUNNING", "after arming")


def _kill_while_driving(bench: Path) -> None:
    with started(bench) as (process, client):
        arm(client)
        process.send_signal(signal.SIGKILL)
        process.wait()
        deadline_s = time.monotonic() + WITHIN_S
        while (bench.parent / "ring.lock").exists() and time.monotonic() < deadline_s and _is_locked(bench):
            time.sleep(0.02)


def _is_locked(bench: Path) -> bool:
    """Whether the control process still ramps down."""
    done = subprocess.run(["flock", "-n", str(bench.parent / "ring.lock"), "true"], check=False)
    return done.returncode != 0


def _imports_ms() -> float:
    begun_s = time.monotonic()
    subprocess.run([sys.executable, "-c", "import numba, pymodbus.pdu, pydantic"], check=True)
    return 1e3 * (time.monotonic() - begun_s)


def _require(found: object, expected: object, when: str) -> None:
    if found != expected:
        raise NotMeasuredError(f"{when}: {found}, expected {expected}")
