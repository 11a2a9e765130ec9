"""The daemon driving for a long time on a machine whose cores are all busy, beside cyclictest on the same cores.

The emulated bench answers over TCP in real time, the daemon follows a triangle at a kilohertz under SCHED_FIFO, a busy
process keeps every core occupied, and cyclictest wakes up at the same rate, policy and priority at the same time: what
it loses, the machine loses, and nobody's program can hold. A fault is counted, reset, and the bench armed again.
"""

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from piezod.commissioning.shipped_files import shipped
from piezod.control import Cause, State
from piezod.daemon.client import Client
from piezod.errors import PiezodError, TemporaryError
from piezod.recording.ring_log import RingReader
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.table import Row, header

PRIORITY = 80
MOST_MISSED_RATIO = 3.0
MOST_RESIDENT_MB = 250.0
LONGEST_US = 1_000_000  # lateness is counted in classes of a microsecond up to here
LOOK_EVERY_S = 0.5
WEIGH_EVERY_S = 2.0
WITHIN_S = 60.0
MIB = 2**20
DEADLINES = {Cause.MISSED_TICKS}

# A machine that stands still for a tenth of a second is not what is looked for: that must end no run.
PATIENCE = {"comm_loss_ms": 2000, "device_watchdog_ms": 1000, "missed_ticks_in_a_row": 500}


@dataclass
class Process:
    """What one process took, over time.

    Attributes
    ----------
    at_s, resident_MB, descriptors
        When it was looked at [s], and what it held then.
    """

    name: str
    pid: int
    at_s: list[float] = field(default_factory=list)
    resident_MB: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)

    def weigh(self, now_s: float) -> None:
        """Look at it."""
        statm = Path(f"/proc/{self.pid}/statm").read_text(encoding="ascii").split()
        self.at_s.append(now_s)
        self.resident_MB.append(int(statm[1]) * os.sysconf("SC_PAGE_SIZE") * 1e-6)
        self.descriptors.append(sum(1 for _ in Path(f"/proc/{self.pid}/fd").iterdir()))

    @property
    def slope_MB_per_h(self) -> float:
        """Growth of the resident memory over the second half [MB/h]."""
        half = len(self.at_s) // 2
        at_h, held = np.array(self.at_s[half:]) / 3600.0, np.array(self.resident_MB[half:])
        return float(np.polyfit(at_h, held, 1)[0]) if at_h.size > 2 else float("nan")


@dataclass
class Soaked:
    """What a soak came to.

    Attributes
    ----------
    ticks, missed
        Of the control loop while it drove.
    stalls, longest_stall
        How often ticks were missed, and most of them in a row.
    late_answers
        Exchanges that lasted longer than a period: the device, or the way to it, had not answered.
    lateness, cyclictest
        Wake-ups by lateness, classes of 1 us; of cyclictest None where it could not run.
    faults
        By name, how often.
    """

    rate_Hz: float
    seconds: float = 0.0
    ticks: int = 0
    missed: int = 0
    stalls: int = 0
    longest_stall: int = 0
    late_answers: int = 0
    lateness: np.ndarray = field(default_factory=lambda: np.zeros(LONGEST_US + 1, dtype=np.int64))
    cyclictest: np.ndarray | None = None
    cyclictest_says: str = ""
    failed_exchanges: int = 0
    rows_dropped: int = 0
    faults: dict[str, int] = field(default_factory=dict)
    processes: list[Process] = field(default_factory=list)
    loads: list[float] = field(default_factory=list)

    @property
    def period_us(self) -> float:
        """Between two deadlines."""
        return 1e6 / self.rate_Hz

    def over_period(self, counts: np.ndarray) -> int:
        """Wake-ups later than a period."""
        return int(counts[int(self.period_us) :].sum())

    def periods_lost(self, counts: np.ndarray) -> int:
        """Whole periods that passed over those wake-ups."""
        return int((counts * (np.arange(counts.size) // int(self.period_us))).sum())

    @property
    def other_faults(self) -> dict[str, int]:
        """Faults that are no missed deadlines."""
        return {name: count for name, count in self.faults.items() if name not in {one.name for one in DEADLINES}}


def soak(duration_s: float, rate_Hz: float, *, on_look: Callable[[Soaked], None] = lambda _soaked: None) -> Soaked:
    """Drive for so long; everything that was started has ended afterwards."""
    soaked = Soaked(rate_Hz)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        with peers.device_priority():
            address = stack.enter_context(peers.emulator("tcp", "real"))
        bench = _bench_file(folder, address, rate_Hz)
        process = stack.enter_context(_ended(_service(bench)))
        client = _connected(bench, process, stack)
        for _ in range(os.cpu_count() or 1):
            stack.enter_context(_ended(_busy()))
        _arm(client)
        soaked.processes = [Process("service", process.pid), Process("control", _control_pid(process.pid))]
        cyclictest = stack.enter_context(_cyclictest(folder, duration_s, rate_Hz, soaked))
        _follow(soaked, client, RingReader(bench.parent / "ring"), duration_s, on_look)
        _hear(soaked, cyclictest, folder)
        client.ask("disarm")
        client.wait_until_settled()
    return soaked


def rows(soaked: Soaked) -> Iterator[Row]:
    """The table."""
    loads = ", ".join(f"{load:.1f}" for load in soaked.loads)
    yield Row(
        "soak", "driven", "s", soaked.seconds, note=f"load average at the beginning, on the way and at the end: {loads}"
    )
    yield Row("soak", f"ticks at {soaked.rate_Hz:g} Hz", "tick", soaked.ticks)
    yield from _timing(soaked)
    named = ", ".join(f"{name.lower()} {count}" for name, count in soaked.faults.items())
    yield Row("soak", "failed exchanges", "", soaked.failed_exchanges)
    yield Row("soak", "faults", "", sum(soaked.faults.values()), most=0, note=named)
    for one in soaked.processes:
        yield from _held(one)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="how long, %(default)g")
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="ticks a second, %(default)g")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON too")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Soak and print; a line that is written over on the way, on a terminal alone."""
    said = _progress(60.0 * options.minutes) if sys.stderr.isatty() else lambda _soaked: None
    table = list(rows(soak(60.0 * options.minutes, options.rate, on_look=said)))
    print(header())
    for row in table:
        print(row.text())
    if options.json:
        options.json.write_text(json.dumps([row.as_dict() for row in table], indent=2) + "\n", encoding="utf-8")


def _progress(duration_s: float) -> Callable[[Soaked], None]:
    def say(soaked: Soaked) -> None:
        text = f"{soaked.seconds:.0f} of {duration_s:.0f} s, {soaked.ticks} ticks, {soaked.missed} missed"
        print(f"\r{text} ", end="", file=sys.stderr, flush=True)

    return say


def _timing(soaked: Soaked) -> Iterator[Row]:
    other = soaked.cyclictest
    yield Row(
        "soak",
        "missed ticks",
        "tick",
        soaked.missed,
        None if other is None else soaked.periods_lost(other),
        "periods that cyclictest lost",
        most_ratio=MOST_MISSED_RATIO,
        note=soaked.cyclictest_says,
    )
    yield Row(
        "soak",
        "times that ticks were missed",
        "",
        soaked.stalls,
        None if other is None else soaked.over_period(other),
        f"wake-ups over a period of cyclictest -m -p{PRIORITY}",
        most_ratio=MOST_MISSED_RATIO,
        note=f"{soaked.late_answers} exchanges lasted over a period: there the emulated device was late, no wake-up",
    )
    for q in (50.0, 99.0, 99.9, 99.99):
        limit = None if other is None else _percentile_us(other, q)
        yield Row("soak", f"lateness, p{q:g}", "us", _percentile_us(soaked.lateness, q), limit, "cyclictest")
    limit = None if other is None else float(np.flatnonzero(other).max(initial=0)) * 1e-3
    longest_ms = 1e-3 * soaked.period_us * soaked.longest_stall
    yield Row("soak", "longest stretch without a tick", "ms", longest_ms, limit, "latest wake-up of cyclictest")


def _percentile_us(counts: np.ndarray, q: float) -> float:
    """The class that the percentile falls into [us]; nan when nothing was counted."""
    total = np.cumsum(counts)
    return float(np.searchsorted(total, 0.01 * q * total[-1])) if total[-1] else float("nan")


def _held(one: Process) -> Iterator[Row]:
    first, last = one.resident_MB[0], one.resident_MB[-1]
    slope = f"{one.slope_MB_per_h:+.2f} MB an hour over the second half, most {max(one.resident_MB):.1f} MB"
    yield Row(
        "soak", f"{one.name}: resident memory", "MB", last, first, "at the beginning", MOST_RESIDENT_MB, note=slope
    )
    first_count, last_count = one.descriptors[0], one.descriptors[-1]
    yield Row(
        "soak", f"{one.name}: descriptors", "", last_count, first_count, "at the beginning", max(one.descriptors[0], 1)
    )


def _follow(
    soaked: Soaked, client: Client, ring: RingReader, duration_s: float, on_look: Callable[[Soaked], None]
) -> None:
    """Read the ring log until the time is over; what goes wrong is counted, and driving goes on."""
    ring.read()
    before = client.ask("status")
    begun_s = time.monotonic()
    weighed_s, next_tick = -WEIGH_EVERY_S, None
    soaked.loads.append(os.getloadavg()[0])
    while soaked.seconds < duration_s:
        time.sleep(LOOK_EVERY_S)
        soaked.seconds = time.monotonic() - begun_s
        next_tick = _take(soaked, ring.read(), next_tick)
        if soaked.seconds - weighed_s >= WEIGH_EVERY_S:
            weighed_s = soaked.seconds
            for one in soaked.processes:
                one.weigh(soaked.seconds)
            _drive_again(soaked, client)
        if len(soaked.loads) == 1 and soaked.seconds > 0.5 * duration_s:
            soaked.loads.append(os.getloadavg()[0])
        on_look(soaked)
    soaked.loads.append(os.getloadavg()[0])
    soaked.failed_exchanges = client.ask("status")["failed_exchanges"] - before["failed_exchanges"]
    soaked.rows_dropped = ring.dropped


def _take(soaked: Soaked, table: np.ndarray, next_tick: int | None) -> int | None:
    """Count ticks, those that are missing between them, and their lateness; returns the tick that comes next."""
    if not table.size:
        return next_tick
    ticks = table["tick"]
    first = int(ticks[0]) if next_tick is None else next_tick
    missing = np.diff(ticks, prepend=first - 1) - 1
    soaked.ticks += int(table.size)
    soaked.missed += int(missing.sum())
    soaked.stalls += int(np.count_nonzero(missing))
    soaked.longest_stall = max(soaked.longest_stall, int(missing.max()))
    late_us = np.clip(table["lateness_ns"] // 1000, 0, LONGEST_US)
    soaked.lateness += np.bincount(late_us, minlength=LONGEST_US + 1)
    soaked.late_answers += int(np.count_nonzero(table["exchange_ns"] > 1e3 * soaked.period_us))
    for row in table[1:][(np.diff(table["state"]) != 0) & (table["state"][1:] == State.FAULT)]:
        name = Cause(row["cause"]).name
        soaked.faults[name] = soaked.faults.get(name, 0) + 1
    return int(ticks[-1]) + 1


def _drive_again(soaked: Soaked, client: Client) -> None:
    """Reset and arm after a fault; one that was not seen in the ring log is counted here."""
    status = client.ask("status")
    if status["state"] == "FAULT":
        if not soaked.faults:
            soaked.faults[status["cause"]] = 1
        client.ask("reset")
        status = client.ask("status")
    if status["state"] == "DISARMED":
        with contextlib.suppress(PiezodError):
            client.ask("arm")


def _bench_file(folder: Path, address: peers.Address, rate_Hz: float) -> Path:
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


def _service(bench: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "piezod", "run", str(bench)]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)


def _connected(bench: Path, process: subprocess.Popen[bytes], stack: contextlib.ExitStack) -> Client:
    """A client of the service, once it is connected to its device."""
    deadline_s = time.monotonic() + WITHIN_S
    while True:
        with contextlib.suppress(PiezodError):
            client = Client(bench.parent / "ring.sock")
            if client.ask("status")["connected"]:
                stack.callback(client.close)
                return client
            client.close()
        if process.poll() is not None or time.monotonic() > deadline_s:
            raise TimeoutError(f"the service did not start within {WITHIN_S:g} s (exit code {process.poll()})")
        time.sleep(0.1)


def _arm(client: Client) -> None:
    """Arm, again and again on a machine too busy to answer."""
    deadline_s = time.monotonic() + WITHIN_S
    while (state := client.wait_until_settled()["state"]) != "RUNNING":
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"after arming the state is {state}, expected RUNNING")
        with contextlib.suppress(TemporaryError):
            client.ask("arm")


def _control_pid(service: int) -> int:
    """The process that the service started and that drives."""
    children = Path(f"/proc/{service}/task/{service}/children").read_text(encoding="ascii").split()
    for child in children:
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise ProcessLookupError(f"process {service} has no control process")


def _busy() -> subprocess.Popen[bytes]:
    """A process that wants a core for itself."""
    return subprocess.Popen([sys.executable, "-c", "while True: pass"], stdin=subprocess.DEVNULL)


@contextlib.contextmanager
def _ended(process: subprocess.Popen[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """The process, ended by its id whatever happens; a service ramps down first."""
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(WITHIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


@contextlib.contextmanager
def _cyclictest(
    folder: Path, duration_s: float, rate_Hz: float, soaked: Soaked
) -> Iterator[subprocess.Popen[bytes] | None]:
    """Cyclictest for as long; None where it is not installed or may not run in real time."""
    program = shutil.which("cyclictest")
    if program is None or not _may_be_real_time():
        soaked.cyclictest_says = "cyclictest: not measured: not installed, or no right to SCHED_FIFO"
        yield None
        return
    loops = round(duration_s * rate_Hz)
    command = [program, "-q", "-m", f"-p{PRIORITY}", f"-i{1e6 / rate_Hz:.0f}", f"-l{loops}", f"-h{LONGEST_US}"]
    command.append(f"--json={folder / 'cyclictest.json'}")
    with _ended(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)) as process:
        yield process


def _hear(soaked: Soaked, process: subprocess.Popen[bytes] | None, folder: Path) -> None:
    """Take in what cyclictest measured; lost wake-ups make it take longer than asked for, so it is told to end."""
    if process is None:
        return
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(5)
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait(WITHIN_S)
    thread = json.loads((folder / "cyclictest.json").read_text(encoding="utf-8"))["thread"]["0"]
    soaked.cyclictest = np.zeros(LONGEST_US + 1, dtype=np.int64)
    for late_us, count in thread["histogram"].items():
        soaked.cyclictest[min(int(late_us), LONGEST_US)] += count


def _may_be_real_time() -> bool:
    chrt = shutil.which("chrt")
    return chrt is not None and subprocess.run([chrt, "-f", str(PRIORITY), "true"], check=False).returncode == 0
