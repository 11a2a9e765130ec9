"""Repeated SIGKILL and SIGSTOP of the control process: the watchdog of the device brings the output to zero.

The device is safe once its watchdog has taken over the output, which then ramps to zero. The limit is the watchdog time
and one device tick. The time counts from the signal, or from a command in transit at that moment. `rest` is the time at
which the output is zero. The emulated device measures both times at its physics steps.
"""

import contextlib
import os
import signal
import statistics
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.faults.bench_pool import raised_priority
from tests.faults.live_bench import TIMING, LiveBench

DEVICE_TICK_MS = 0.25  # sampling at 4 kHz
SAFE_WITHIN_MS = TIMING["device_watchdog_ms"] + DEVICE_TICK_MS
READY_WITHIN_MS = 2000.0
REST_WITHIN_MS = SAFE_WITHIN_MS + 1000.0 * 140 / 400  # from 140 V, at the ramp of the device


@dataclass
class Kills:
    """Results of repeated signals of one kind."""

    how: str
    safe_ms: list[float] = field(default_factory=list)
    rest_ms: list[float] = field(default_factory=list)
    ready_ms: list[float] = field(default_factory=list)
    written_afterwards: int = 0
    wrong: list[str] = field(default_factory=list)
    armings: int = 0
    disarmed: int = 0

    @property
    def times(self):
        return len(self.safe_ms)

    @property
    def safe(self):
        """Number of signals after which the device was safe in time."""
        return sum(one <= SAFE_WITHIN_MS for one in self.safe_ms)

    def problems(self):
        bad = [] if self.safe == self.times else [f"safe in time {self.safe} of {self.times}"]
        bad += [f"output outside its envelope: {self.wrong[0]}"] if self.wrong else []
        bad += [f"armed {self.armings} times by itself"] if self.armings else []
        bad += [f"{self.written_afterwards} commands after it went on"] if self.written_afterwards else []
        bad += [] if self.disarmed == self.times else [f"DISARMED or FAULT {self.disarmed} of {self.times}"]
        bad += [f"at rest after {max(self.rest_ms):.0f} ms"] if max(self.rest_ms) > REST_WITHIN_MS else []
        return bad


def kill(bench, how, found):
    """Arm, kill or stop the control process once, and add the result to `found`."""
    bench.restore()
    bench.arm(settle_s=0.1)
    victim, parent = bench.service.control_pid(), bench.service.process.pid
    bench.device.ask("mark")
    begun_ns = time.monotonic_ns()
    if how == "SIGKILL":  # both: otherwise the control process would detect the end of its parent and ramp down
        os.kill(victim, signal.SIGKILL)
        os.kill(parent, signal.SIGKILL)
    else:
        os.kill(victim, signal.SIGSTOP)
    report = _await_rest(bench)
    counted_ns = max(begun_ns, report["command_ns"])  # a command in transit arrives after the signal
    found.safe_ms.append((report["taken_over_ns"] - counted_ns) / 1e6 if report["taken_over_ns"] else float("inf"))
    found.rest_ms.append((report["rest_ns"] - begun_ns) / 1e6 if report["rest_ns"] else float("inf"))
    found.wrong += report["wrong"]
    if how == "SIGKILL":
        bench.service.process.wait()
        bench.drop()
        found.ready_ms.append(1e3 * bench.start())
        found.disarmed += bench.wait_state("DISARMED") == "DISARMED"
    else:
        commands = report["commands"]
        os.kill(victim, signal.SIGCONT)
        found.disarmed += bench.wait_state("FAULT") == "FAULT"
        afterwards = bench.device.ask("report")
        found.written_afterwards += afterwards["commands"] - commands
        found.wrong += afterwards["wrong"]


def _await_rest(bench):
    deadline_s = time.monotonic() + 5.0
    while True:
        report = bench.device.ask("report")
        if (report["rest_ns"] and report["taken_over_ns"]) or time.monotonic() > deadline_s:
            return report
        time.sleep(0.02)


def kills(how, times, show=None):
    """Kill or stop `times` times on one bench."""
    found = Kills(how)
    with (
        raised_priority(),
        tempfile.TemporaryDirectory(prefix="piezod-kills-") as folder,
        _bench(Path(folder) / "bench") as bench,
    ):
        for _ in range(times):
            kill(bench, how, found)
            if show is not None:
                show(found)
        found.armings = bench.rearms
    return found


@contextlib.contextmanager
def _bench(folder):
    bench = LiveBench(folder)
    try:
        yield bench
    finally:
        bench.close()


def line(found):
    """The row of the table."""

    def spread(values):
        return f"{statistics.median(values):7.1f} {max(values):7.1f}" if values else f"{'-':>7} {'-':>7}"

    fastest = f"fastest {min(found.ready_ms):.0f} ms" if found.ready_ms else ""

    in_time = sum(one <= READY_WITHIN_MS for one in found.ready_ms)
    ready = f"{in_time} of {len(found.ready_ms)}" if found.ready_ms else "-"
    return (
        f"{found.how:<8} {found.safe:>3} of {found.times:<3} {spread(found.safe_ms)} {SAFE_WITHIN_MS:9.2f}  "
        f"{spread(found.rest_ms)}  {spread(found.ready_ms)} {ready:>10}  {found.armings:>8}  {fastest}"
    )


HEADER = (
    "signal   safe in time  safe after [ms]  limit  at rest after [ms]  READY after [ms]   within 2 s  re-arms\n"
    f"{'':22}  median     max            median     max    median     max"
)
