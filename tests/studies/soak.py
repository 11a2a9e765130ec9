"""A long run of the daemon on a machine with busy cores, beside cyclictest on the same cores.

The emulated bench answers over TCP in real time. The daemon follows a triangle at 1 kHz under SCHED_FIFO, and a busy
process loads each core. cyclictest runs at the same time with the same rate, policy and priority. Periods that it loses
are lost by the machine, not by the daemon. After a fault, which is counted, the bench is reset and armed again.
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

from piezod.control import Cause, State
from piezod.daemon.client import Client
from piezod.errors import PiezodError, TemporaryError
from piezod.recording.ring_log import RingReader
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.service import bench_file
from tests.benchmarks.table import Row, header

PRIORITY = 80
MOST_MISSED_RATIO = 3.0
MOST_RESIDENT_MB = 250.0
LONGEST_US = 1_000_000  # largest lateness class; the classes have a width of 1 us
READ_EVERY_S = 0.5
SAMPLE_EVERY_S = 2.0
WITHIN_S = 60.0
MIB = 2**20
DEADLINES = {Cause.MISSED_TICKS}

# Limits that a standstill of the machine of 0.1 s does not exceed.


@dataclass
class Process:
    """Resources of one process over time.

    Attributes
    ----------
    at_s, resident_MB, descriptors
        Time of each sample [s], resident memory [MB] and number of open descriptors.
    """

    name: str
    pid: int
    at_s: list[float] = field(default_factory=list)
    resident_MB: list[float] = field(default_factory=list)
    descriptors: list[int] = field(default_factory=list)

    def sample_resources(self, now_s: float) -> None:
        """Append one sample."""
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
    """Result of a soak run.

    Attributes
    ----------
    ticks, missed
        Ticks of the control loop while driving, and missed ticks.
    stalls, longest_stall
        Number of gaps with missed ticks, and the largest number of ticks in one gap.
    late_answers
        Number of exchanges longer than a period, caused by the device or the network.
    lateness, cyclictest
        Numbers of wake-ups by lateness in classes of 1 us; cyclictest: None where it could not run.
    faults
        Number of faults by name.
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
        """Period of the deadlines [us]."""
        return 1e6 / self.rate_Hz

    def over_period(self, counts: np.ndarray) -> int:
        """Number of wake-ups later than a period."""
        return int(counts[int(self.period_us) :].sum())

    def periods_lost(self, counts: np.ndarray) -> int:
        """Number of whole periods lost by those wake-ups."""
        return int((counts * (np.arange(counts.size) // int(self.period_us))).sum())

    @property
    def other_faults(self) -> dict[str, int]:
        """Faults other than missed deadlines."""
        return {name: count for name, count in self.faults.items() if name not in {one.name for one in DEADLINES}}


def soak(duration_s: float, rate_Hz: float, *, on_look: Callable[[Soaked], None] = lambda _soaked: None) -> Soaked:
    """Drive for `duration_s`; all started processes end afterwards."""
    soaked = Soaked(rate_Hz)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        with peers.device_priority():
            address = stack.enter_context(peers.emulator("tcp", "real"))
        bench = bench_file(folder, address, rate_Hz)
        process = stack.enter_context(_ended(_service(bench)))
        client = _connected(bench, process, stack)
        for _ in range(os.cpu_count() or 1):
            stack.enter_context(_ended(_busy()))
        _arm(client)
        soaked.processes = [Process("service", process.pid), Process("control", _control_pid(process.pid))]
        cyclictest = stack.enter_context(_cyclictest(folder, duration_s, rate_Hz, soaked))
        _follow(soaked, client, RingReader(bench.parent / "ring"), duration_s, on_look)
        _read_cyclictest(soaked, cyclictest, folder)
        client.ask("disarm")
        client.wait_until_settled()
    return soaked


def rows(soaked: Soaked) -> Iterator[Row]:
    """The rows of the table."""
    loads = ", ".join(f"{load:.1f}" for load in soaked.loads)
    yield Row("soak", "driven", "s", soaked.seconds, note=f"load average at start, middle and end: {loads}")
    yield Row("soak", f"ticks at {soaked.rate_Hz:g} Hz", "tick", soaked.ticks)
    yield from _timing(soaked)
    named = ", ".join(f"{name.lower()} {count}" for name, count in soaked.faults.items())
    yield Row("soak", "failed exchanges", "", soaked.failed_exchanges)
    yield Row("soak", "faults", "", sum(soaked.faults.values()), most=0, note=named)
    for one in soaked.processes:
        yield from _held(one)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="duration, %(default)g")
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="rate of the loop, %(default)g")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.set_defaults(run=_run)


def _run(options: argparse.Namespace, _parser: argparse.ArgumentParser) -> None:
    """Run the soak and print the table; on a terminal with a progress line."""
    on_look = _progress(60.0 * options.minutes) if sys.stderr.isatty() else lambda _soaked: None
    table = list(rows(soak(60.0 * options.minutes, options.rate, on_look=on_look)))
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
        note=f"{soaked.late_answers} exchanges took over a period: the emulated device was late, not the wake-up",
    )
    for q in (50.0, 99.0, 99.9, 99.99):
        limit = None if other is None else _percentile_us(other, q)
        yield Row("soak", f"lateness, p{q:g}", "us", _percentile_us(soaked.lateness, q), limit, "cyclictest")
    limit = None if other is None else float(np.flatnonzero(other).max(initial=0)) * 1e-3
    longest_ms = 1e-3 * soaked.period_us * soaked.longest_stall
    yield Row("soak", "longest stretch without a tick", "ms", longest_ms, limit, "latest wake-up of cyclictest")


def _percentile_us(counts: np.ndarray, q: float) -> float:
    """The class of the percentile [us]; nan without counts."""
    total = np.cumsum(counts)
    return float(np.searchsorted(total, 0.01 * q * total[-1])) if total[-1] else float("nan")


def _held(one: Process) -> Iterator[Row]:
    first, last = one.resident_MB[0], one.resident_MB[-1]
    slope = f"{one.slope_MB_per_h:+.2f} MB/h over the second half, most {max(one.resident_MB):.1f} MB"
    yield Row("soak", f"{one.name}: resident memory", "MB", last, first, "at start", MOST_RESIDENT_MB, note=slope)
    first_count, last_count = one.descriptors[0], one.descriptors[-1]
    yield Row("soak", f"{one.name}: descriptors", "", last_count, first_count, "at start", max(one.descriptors[0], 1))


def _follow(
    soaked: Soaked, client: Client, ring: RingReader, duration_s: float, on_look: Callable[[Soaked], None]
) -> None:
    """Read the ring log for `duration_s`; faults are counted, and driving continues."""
    ring.read()
    before = client.ask("status")
    begun_s = time.monotonic()
    sampled_s, next_tick = -SAMPLE_EVERY_S, None
    soaked.loads.append(os.getloadavg()[0])
    while soaked.seconds < duration_s:
        time.sleep(READ_EVERY_S)
        soaked.seconds = time.monotonic() - begun_s
        next_tick = _take(soaked, ring.read(), next_tick)
        if soaked.seconds - sampled_s >= SAMPLE_EVERY_S:
            sampled_s = soaked.seconds
            for one in soaked.processes:
                one.sample_resources(soaked.seconds)
            _drive_again(soaked, client)
        if len(soaked.loads) == 1 and soaked.seconds > 0.5 * duration_s:
            soaked.loads.append(os.getloadavg()[0])
        on_look(soaked)
    soaked.loads.append(os.getloadavg()[0])
    soaked.failed_exchanges = client.ask("status")["failed_exchanges"] - before["failed_exchanges"]
    soaked.rows_dropped = ring.dropped


def _take(soaked: Soaked, table: np.ndarray, next_tick: int | None) -> int | None:
    """Count ticks, missing ticks and lateness; returns the number of the next tick."""
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
    """Reset and arm after a fault; counts a fault that the ring log did not show."""
    status = client.ask("status")
    if status["state"] == "FAULT":
        if not soaked.faults:
            soaked.faults[status["cause"]] = 1
        client.ask("reset")
        status = client.ask("status")
    if status["state"] == "DISARMED":
        with contextlib.suppress(PiezodError):
            client.ask("arm")


def _service(bench: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "piezod", "run", str(bench)]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL)


def _connected(bench: Path, process: subprocess.Popen[bytes], stack: contextlib.ExitStack) -> Client:
    """A client of the service, after the service is connected to its device."""
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
    """Arm; repeats on a machine that is too busy to answer."""
    deadline_s = time.monotonic() + WITHIN_S
    while (state := client.wait_until_settled()["state"]) != "RUNNING":
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"after arming the state is {state}, expected RUNNING")
        with contextlib.suppress(TemporaryError):
            client.ask("arm")


def _control_pid(service: int) -> int:
    """Process id of the control process of the service."""
    children = Path(f"/proc/{service}/task/{service}/children").read_text(encoding="ascii").split()
    for child in children:
        if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise ProcessLookupError(f"process {service} has no control process")


def _busy() -> subprocess.Popen[bytes]:
    """A process that uses a full core."""
    return subprocess.Popen([sys.executable, "-c", "while True: pass"], stdin=subprocess.DEVNULL)


@contextlib.contextmanager
def _ended(process: subprocess.Popen[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """Yield the process and end it afterwards; a service ramps down first."""
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
    """Run cyclictest for `duration_s`; yields None where it is missing or has no real-time right."""
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


def _read_cyclictest(soaked: Soaked, process: subprocess.Popen[bytes] | None, folder: Path) -> None:
    """Read the result of cyclictest; SIGINT ends it, since lost wake-ups prolong its run."""
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
