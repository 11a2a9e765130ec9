"""The daemon with everything that may look at it at once, beside the same bench alone.

Fifty clients of the socket ask for the status, each once a second. Three viewers have the live page open. The recorder
runs, and the MQTT bridge to a broker of this machine. Everything is on the loopback interface and ends afterwards.
"""

import argparse
import contextlib
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from piezod.control import State
from piezod.daemon.client import Client
from piezod.errors import PiezodError
from piezod.recording.ring_log import RingReader
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.service import bench_file
from tests.benchmarks.table import NotMeasuredError
from tests.studies.soak import (
    Process,
    Soaked,
    _arm,
    _connected,
    _control_pid,
    _ended,
    _follow,
    _percentile_us,
    _service,
)

CLIENTS, VIEWERS = 50, 3
SETTLED_S = 5.0  # from the start of the companions to the measurement
REST_WITHIN_S = 10.0
QUIET = {"stdin": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}


@dataclass(frozen=True)
class Loaded:
    """Figures of one run.

    Parameters
    ----------
    soaked
        Ticks, lateness and resources of the processes.
    stop_s
        Time from the request of a stop to the safe voltage [s].
    stop_V
        Voltage at the request [V].
    answers, slowest_s
        Number of answers to the clients, and the longest wait for one [s].
    """

    soaked: Soaked
    stop_s: float
    stop_V: float
    answers: int = 0
    slowest_s: float = 0.0


def run_bench(seconds: float, rate_Hz: float, *, loaded: bool) -> Loaded:
    """Drive a bench for some seconds and stop it, with all companions or alone."""
    soaked = Soaked(rate_Hz)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="piezod-load-")))
        with peers.device_priority():
            address = stack.enter_context(peers.emulator("tcp", "real"))
        bench = bench_file(folder, address, rate_Hz)
        if loaded:
            content = yaml.safe_load(bench.read_text(encoding="utf-8"))
            content["recorder"] = {"folder": str(folder / "recordings")}
            bench.write_text(yaml.safe_dump(content), encoding="utf-8")
        service = stack.enter_context(_ended(_service(bench)))
        client = _connected(bench, service, stack)
        _arm(client)
        soaked.processes = [Process("service", service.pid), Process("control", _control_pid(service.pid))]
        clients = None
        if loaded:
            soaked.processes += _companions(bench, stack)
            seconds_there = str(SETTLED_S + seconds)
            clients = stack.enter_context(_ended(_looking("clients", str(bench.parent / "ring.sock"), seconds_there)))
        time.sleep(SETTLED_S)
        client = _connected(bench, service, stack)  # the daemon closes a connection that was silent for ten seconds
        _follow(soaked, client, RingReader(bench.parent / "ring"), seconds, lambda _: None)
        stop_s, stop_V = _stop(bench, client)
        answers, slowest_s = _answers(clients)
    return Loaded(soaked, stop_s, stop_V, answers, slowest_s)


def _companions(bench: Path, stack: contextlib.ExitStack) -> list[Process]:
    """Start broker, bridge, live page and its viewers."""
    broker = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
    if broker is None:
        raise NotMeasuredError("mosquitto is not installed: apt-get install mosquitto")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    stack.enter_context(_ended(subprocess.Popen([broker, "-p", port], stdout=subprocess.DEVNULL, **QUIET)))
    piezod = [sys.executable, "-m", "piezod"]
    command = [*piezod, "bridge", str(bench), "--mqtt", f"mqtt://127.0.0.1:{port}"]
    bridge = stack.enter_context(_ended(subprocess.Popen(command, stdout=subprocess.DEVNULL, **QUIET)))
    command = [*piezod, "watch", str(bench), "--port", "0"]
    page = stack.enter_context(_ended(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **QUIET)))
    assert page.stdout is not None
    address = page.stdout.readline().split()[2]
    stack.callback(page.stdout.close)
    viewers = stack.enter_context(_ended(_looking("viewers", address, "inf")))
    assert viewers.stdout is not None
    stack.callback(viewers.stdout.close)
    if [viewers.stdout.readline() for _ in range(VIEWERS)] != VIEWERS * ["viewing\n"]:
        raise NotMeasuredError(f"no viewer of {address} is served")
    return [Process("MQTT bridge", bridge.pid), Process("live page", page.pid)]


def _looking(what: str, where: str, seconds: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "tests.studies.load_clients", what, where, seconds]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **QUIET)


def _answers(clients: subprocess.Popen[str] | None) -> tuple[int, float]:
    """Number of answers to the clients, and the longest wait [s]."""
    if clients is None:
        return 0, 0.0
    told = json.loads(clients.communicate(timeout=60.0)[0])
    if told["refused"]:
        print(f"{told['refused']} of {CLIENTS} clients were ended: {told['reason']}")
    return told["answers"], told["slowest_s"]


def _stop(bench: Path, client: Client) -> tuple[float, float]:
    """Stop; returns the time to the safe voltage [s] and the voltage at the request [V]."""
    ring = RingReader(bench.parent / "ring")
    voltage_V = float(ring.read()["voltage_V"][-1])
    begun_s = time.monotonic()
    client.ask("stop")
    while time.monotonic() - begun_s < REST_WITHIN_S:
        rows = ring.read()
        if rows.size and rows["state"][-1] == State.DISARMED:
            return time.monotonic() - begun_s, voltage_V
        time.sleep(0.002)
    return float("inf"), voltage_V


def table(alone: Loaded, loaded: Loaded) -> Iterator[str]:
    """Lines of the table."""
    yield f"{'':<42}{'alone':>14}{'with load':>14}"
    a, b = alone.soaked, loaded.soaked
    yield _line(f"ticks at {a.rate_Hz:g} Hz", str(a.ticks), str(b.ticks))
    yield _line("ticks missed", str(a.missed), str(b.missed))
    for q in (50.0, 99.0, 99.9):
        yield _line(f"lateness, {q:g} % [us]", *(f"{_percentile_us(one.lateness, q):.0f}" for one in (a, b)))
    yield _line("failed exchanges", str(a.failed_exchanges), str(b.failed_exchanges))
    yield _line("faults", str(sum(a.faults.values())), str(sum(b.faults.values())))
    yield _line(
        "stop to safe voltage [s], from [V]", *(f"{one.stop_s:.3f}, {one.stop_V:.0f}" for one in (alone, loaded))
    )
    yield _line("status answers", "", str(loaded.answers))
    yield _line("slowest of them [s]", "", f"{loaded.slowest_s:.3f}")
    before = {one.name: one for one in a.processes}
    for one in b.processes:
        yield _line(f"{one.name}: memory, begin to end [MB]", _memory(before.get(one.name)), _memory(one))
        yield _line(f"{one.name}: descriptors", _descriptors(before.get(one.name)), _descriptors(one))


def _line(what: str, alone: str, loaded: str) -> str:
    return f"{what:<42}{alone:>14}{loaded:>14}"


def _memory(one: Process | None) -> str:
    return "" if one is None else f"{one.resident_MB[0]:.1f} {one.resident_MB[-1]:.1f}"


def _descriptors(one: Process | None) -> str:
    return "" if one is None else f"{one.descriptors[0]} {one.descriptors[-1]}"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="duration of each run, %(default)g")
    parser.add_argument("--rate", type=float, default=200.0, metavar="HZ", help="rate of the loop, %(default)g")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    try:
        alone = run_bench(options.seconds, options.rate, loaded=False)
        loaded = run_bench(options.seconds, options.rate, loaded=True)
    except (NotMeasuredError, PiezodError) as error:
        parser.error(str(error))
    print("\n".join(table(alone, loaded)))
