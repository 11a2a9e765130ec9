"""Ticks that a driving service misses alone, and beside each companion: live page, MQTT, OPC UA, EPICS."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from piezod.daemon.client import Client
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.service import arm, bench_file, started
from tests.benchmarks.table import NotMeasuredError, Row

ROUNDS, ROUND_S = 4, 10.0
SETTLED_S = 3.0
IOC = Path(__file__).parents[2] / "config" / "piezod_ioc.py"
LOOPBACK = {"EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1", "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1"}


def measure(*, quick: bool) -> Iterator[Row]:
    """One row for each companion; the limit is the service alone, in the same rounds."""
    broker = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
    if broker is None:
        raise NotMeasuredError("needs mosquitto")
    rounds, round_s = (1, 3.0) if quick else (ROUNDS, ROUND_S)
    with tempfile.TemporaryDirectory() as name, peers.emulator("tcp", "real") as address:
        bench, mqtt, opcua = bench_file(Path(name), address), _free_port(), _free_port()
        with _running([broker, "-p", str(mqtt)]), started(bench) as (_, client):
            arm(client)
            piezod = [sys.executable, "-m", "piezod"]
            companions = {
                "alone": None,
                "live page": [*piezod, "watch", str(bench), "--port", "0"],
                "MQTT": [*piezod, "bridge", str(bench), "--mqtt", f"mqtt://127.0.0.1:{mqtt}"],
                "OPC UA": [*piezod, "bridge", str(bench), "--opcua", str(opcua)],
                "EPICS": [sys.executable, str(IOC), str(bench), f"PIEZOD-{os.getpid()}"],
            }
            shares: dict[str, list[float]] = {what: [] for what in companions}
            for _ in range(rounds):
                for what, command in companions.items():
                    with contextlib.nullcontext() if command is None else _running(command):
                        time.sleep(SETTLED_S)
                        shares[what].append(_missed_per_million(client, round_s))
    alone = float(np.median(shares["alone"]))
    for what, found in shares.items():
        note = f"{min(found):.0f} to {max(found):.0f} in {len(found)} rounds of {round_s:g} s"
        yield Row("companions", f"ticks missed, {what}", "1e-6", float(np.median(found)), alone, "alone", note=note)


def _missed_per_million(client: Client, seconds: float) -> float:
    before = after = client.ask("status")
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        time.sleep(1.0)  # the daemon closes a connection that is silent for longer
        after = client.ask("status")
    ticks, missed = (after[name] - before[name] for name in ("ticks", "missed"))
    return 1e6 * missed / (ticks + missed)


@contextlib.contextmanager
def _running(command: list[str]) -> Iterator[None]:
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, env=os.environ | LOOPBACK)
    try:
        yield
        if process.poll() is not None:
            raise NotMeasuredError(f"{command[-1]} ended with {process.returncode}")
    finally:
        process.terminate()
        process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
