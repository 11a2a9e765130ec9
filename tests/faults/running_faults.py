"""Faults of a running bench: of its wire, device, load cell and machine.

A step of an injection is a mapping with one key of `STEPS` and the arguments of that step.
"""

import contextlib
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from pymodbus.client import ModbusTcpClient

from piezod.control import State
from piezod.transport import ExchangeResult
from tests.faults.bench_pool import InjectionUnavailableError, Observation
from tests.faults.forgeries import MARK_N
from tests.faults.live_bench import TICK_MS, boot_ns, exchange_end_ns, first_row

DRIVING = (State.ARMING, State.RUNNING, State.HOLD)
PAGE_KIB = os.sysconf("SC_PAGE_SIZE") // 1024


def running(pool, fault, *, steps, wire="tcp", before=(), for_s=0.5, changes=None, ends=False):
    """Arm, follow the reference, do the steps, and observe until an expected state or for `for_s`."""
    bench = pool.bench(wire, **(changes or {}))
    observed = Observation()
    bench.arm()
    for step in before:
        do(bench, step)
    watch = Watch(bench)
    for step in steps:
        answer = do(bench, step)
        if answer is not None:  # time at which the device process began the step
            watch.begun_ns = answer["now_ns"]
    watch.until(fault.expect.states, for_s, fault.within_ms)
    watch.finish(observed)
    if ends:
        observed.exit_code = bench.service.end()
        observed.text = bench.service.log(watch.log_start)
    bench.restore()
    time.sleep(0.1)
    observed.armings = bench.rearms
    return observed


def variants(pool, fault, *, each, **more):
    """Inject each of several variants with `running` and return the worst observation."""
    observed = [running(pool, fault, steps=steps, **more) for steps in each]
    worst = max(observed, key=lambda one: (bool(one.deviations(fault)), one.after_ms))
    worst.figures["variants"] = len(observed)
    return worst


def disarmed(pool, fault, *, steps, wire="tcp", for_s=1.0):
    """Do the steps while disarmed, and observe for `for_s`."""
    bench = pool.bench(wire)
    observed = Observation()
    watch = Watch(bench)
    for step in steps:
        do(bench, step)
    time.sleep(for_s)
    watch.finish(observed)
    bench.restore()
    observed.armings = bench.rearms
    return observed


class Watch:
    """Observation of a bench from now on: rows of the ring log, log lines, resources of the control process."""

    def __init__(self, bench):
        self.bench = bench
        self.log_start = len(bench.service.log_lines)
        self.pid = bench.service.control_pid()
        self.descriptors, self.resident = _descriptors(self.pid), _resident_kib(self.pid)
        self.accepted = bench.device.ask("report")["accepted"]
        self.parts = []
        bench.notes = {"pid": self.pid}
        self.last = bench.rows()[-1]
        self.begun_ns = bench.device.ask("mark")["now_ns"]

    def until(self, states, for_s, within_ms):
        """Wait for one of the states; wait `for_s` when RUNNING or no state is expected."""
        deadline_s = time.monotonic() + 1e-3 * within_ms + 3.0
        if "RUNNING" not in states and states not in ((), ("none",)):
            while self._state() not in states and time.monotonic() < deadline_s and self.bench.service.alive:
                time.sleep(0.01)
        else:
            time.sleep(for_s)

    def _state(self):
        rows = self.bench.rows()
        if rows.size:
            self.parts.append(rows)
            self.last = rows[-1]
        return State(int(self.last["state"])).name

    def finish(self, observed):
        """Fill in state, time, figures and text of the observation."""
        observed.state = self._state()
        time.sleep(0.25)  # the parent process polls at 10 Hz and then writes its log
        self._state()
        rows = np.concatenate(self.parts) if self.parts else np.atleast_1d(self.last)
        report = self.bench.device.ask("report")
        observed.wrong = report["wrong"]
        observed.text = self.bench.service.log(self.log_start)
        begun_ns = boot_ns(self.begun_ns)
        safe = first_row(rows, "RAMP_DOWN", "FAULT")
        if safe is not None:
            observed.after_ms = max(0.0, (exchange_end_ns(rows[safe]) - begun_ns) / 1e6)
        observed.figures |= self._figures(rows, report, safe)

    def _figures(self, rows, report, safe):
        results = {result.name.lower(): int((rows["result"] == result).sum()) for result in ExchangeResult}
        good = np.flatnonzero(rows["result"] == 0)
        times_ms = rows["time_ns"] / 1e6
        figures = {
            **results,
            "failed": int(rows.size - good.size),
            "slow": int((rows["exchange_ns"] > 0.4e6 * TICK_MS).sum()),
            "marked": int((rows["force_N"] == MARK_N).sum()),
            "missed": int(rows["tick"][-1] - rows["tick"][0] + 1 - rows.size),
            "rows_a_tick": _most_in(times_ms, TICK_MS),
            "longest_silence_ms": _longest_gap(times_ms[good]),
            "descriptors_grown": _descriptors(self.pid) - self.descriptors,
            "resident_grown_kib": _resident_kib(self.pid) - self.resident,
            "reconnected": report["accepted"] - self.accepted,
            "commands": report["commands"],
            "watchdog_ms": report["watchdog_ms"],
            "highest_V": report["highest_V"] or 0.0,
            "deeds": report["deeds"],
            "behind_ms": report["behind_ms"],
        }
        if safe is not None:
            figures["ticks_to_command"] = _ticks_to_command(rows, safe)
            before = good[good <= safe]
            last_ns = exchange_end_ns(rows[before[-1]]) if before.size else boot_ns(self.begun_ns)
            figures["silence_ms"] = (exchange_end_ns(rows[safe]) - last_ns) / 1e6
        if "commands" in self.bench.notes:
            figures["commands_afterwards"] = report["commands"] - self.bench.notes["commands"]
        if "cpu_percent" in self.bench.notes:
            figures["cpu_percent"] = self.bench.notes["cpu_percent"]
        if report["taken_over_ns"] is not None:
            figures["device_took_over_ms"] = (report["taken_over_ns"] - self.begun_ns) / 1e6
        return figures


def _ticks_to_command(rows, safe):
    """Ticks from the row that detects the fault to the first lower command."""
    lower = np.flatnonzero(rows["voltage_V"][safe:] < rows["voltage_V"][safe] - 1e-6)
    return float(lower[0]) if lower.size else float("inf")


def _most_in(times_ms, width_ms):
    """The largest number of times within a window of this width."""
    ends = np.searchsorted(times_ms, times_ms + 0.999 * width_ms)
    return int((ends - np.arange(times_ms.size)).max())


def _longest_gap(times_ms):
    return float(np.diff(times_ms).max()) if times_ms.size > 1 else 0.0


def _descriptors(pid):
    try:
        return sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return 0


def _resident_kib(pid):
    try:
        return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE_KIB
    except OSError:
        return 0


# the steps ----------------------------------------------------------------------------------------------------------


def do(bench, step):
    """Do one step; returns the answer of the device process, if any."""
    ((name, arguments),) = step.items()
    return STEPS[name](bench, arguments)


def _wire(bench, what):
    return bench.device.ask("wire", what=what)


def _rules(bench, rules):
    return bench.device.ask("rules", rules=list(rules))


def _flap(bench, arguments):
    for _ in range(arguments["times"]):
        _wire(bench, "refuse")
        time.sleep(arguments["off_s"])
        _wire(bench, "restore")
        time.sleep(arguments["on_s"])


def _stop_and_go(bench, arguments):
    """Stop the control process for `for_s` with SIGSTOP and SIGCONT."""
    pid = bench.notes["pid"]
    for _ in range(arguments.get("times", 1)):
        os.kill(pid, signal.SIGSTOP)
        time.sleep(arguments["for_s"])
        bench.notes["commands"] = bench.device.ask("report")["commands"]
        os.kill(pid, signal.SIGCONT)
        time.sleep(arguments.get("pause_s", 0.0))


def _load(bench, arguments):
    with busy_machine():
        time.sleep(arguments["for_s"])


@contextlib.contextmanager
def busy_machine():
    """Run two busy processes for each core."""
    count = 2 * (os.cpu_count() or 1)
    program = "import os; os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))\nwhile True: pass"
    busy = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(count)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _write_as_second_client(bench, arguments):
    """Write the set point from a second client, `above_V` above the set point of the daemon."""
    host, _, port = bench.device.serves["direct"].rpartition(":")
    written_V = None
    with ModbusTcpClient(host, port=int(port), timeout=2) as client:
        end_s = time.monotonic() + arguments["for_s"]
        while time.monotonic() < end_s:
            words = client.read_holding_registers(100, count=2, device_id=1).registers
            found_V = struct.unpack(">f", struct.pack(">2H", *words))[0]
            if found_V == written_V:  # the daemon has not written since
                continue
            written = struct.pack(">f", found_V + arguments["above_V"])
            written_V = struct.unpack(">f", written)[0]
            client.write_registers(100, list(struct.unpack(">2H", written)), device_id=1)


def _replug(bench, arguments):
    _wire(bench, "unplug")
    time.sleep(arguments["after_s"])
    _wire(bench, "plug")
    time.sleep(arguments["settle_s"])


def _measure_cpu(bench, arguments):
    """Measure the CPU load of the control process [% of a core]."""
    before_s = _cpu_s(bench.notes["pid"])
    time.sleep(arguments["for_s"])
    bench.notes["cpu_percent"] = 100.0 * (_cpu_s(bench.notes["pid"]) - before_s) / arguments["for_s"]


def _cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _trace(bench, arguments):
    """Let system calls of the control process fail at intervals, by strace."""
    if shutil.which("strace") is None:
        raise InjectionUnavailableError("strace is not installed")
    injected = [f"inject={calls}:error={error}:when={when}" for calls, error, when in arguments["inject"]]
    traced = ",".join(calls for calls, _, _ in arguments["inject"])
    tracer = subprocess.Popen(
        ["strace", "-qq", "-f", "-o", "/dev/null", "-e", f"trace={traced}",
         *(word for rule in injected for word in ("-e", rule)), "-p", str(bench.notes["pid"])],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(arguments["for_s"])
    early = tracer.poll()
    if early is None:
        tracer.terminate()
    refusal = tracer.communicate(timeout=10)[1]
    if early is not None:
        raise InjectionUnavailableError(f"strace cannot trace here: {refusal.strip()[:80]}")


STEPS = {
    "rules": _rules,
    "wire": _wire,
    "write_beside": _write_as_second_client,
    "flap": _flap,
    "stop_and_go": _stop_and_go,
    "load": _load,
    "replug": _replug,
    "measure_cpu": _measure_cpu,
    "trace": _trace,
}

INJECTORS = {"running": running, "variants": variants, "disarmed": disarmed}
