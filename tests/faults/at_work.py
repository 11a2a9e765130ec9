"""Faults of a bench that is at work: of its wire, its device, its load cell, its machine.

A step of an injection is a mapping with one key, what to do, and its arguments, as `DOES` lists them.
"""

import contextlib
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
from pymodbus.client import ModbusTcpClient

from piezod.control import State
from piezod.errors import PiezodError
from piezod.transport import ExchangeResult
from tests.faults.forgeries import MARK_N
from tests.faults.live import TICK_MS, boot_ns, ended_ns, first_row
from tests.faults.stand import CannotBeDoneHereError, Seen

DRIVING = (State.ARMING, State.RUNNING, State.HOLD)
PAGE_KIB = os.sysconf("SC_PAGE_SIZE") // 1024


def running(stand, fault, *, steps, wire="tcp", before=(), for_s=0.5, changes=None, ends=False):
    """Arm, follow the reference, do the steps, and watch until the state that is expected has come, or for a while."""
    bench = stand.bench(wire, **(changes or {}))
    seen = Seen()
    bench.arm()
    for step in before:
        do(bench, step)
    watch = Watch(bench)
    for step in steps:
        answer = do(bench, step)
        if answer is not None:  # the stage says when it began; a step that takes its time began when it was told
            watch.begun_ns = answer["now_ns"]
    watch.until(fault.expect.states, for_s, fault.within_ms)
    watch.tell(seen)
    if ends:
        seen.exit_code = bench.service.end()
        seen.text = bench.service.log(watch.said)
    bench.heal()
    time.sleep(0.1)
    seen.armings = bench.rearms
    return seen


def variants(stand, fault, *, each, **more):
    """The same for several injections, one after the other: the worst of them."""
    seen = [running(stand, fault, steps=steps, **more) for steps in each]
    worst = max(seen, key=lambda one: (bool(one.judged(fault)), one.after_ms))
    worst.figures["variants"] = len(seen)
    return worst


def arming(stand, fault, *, steps, wire="tcp"):
    """Do the steps while disarmed, then arm."""
    bench = stand.bench(wire)
    seen = Seen()
    for step in steps:
        do(bench, step)
    watch = Watch(bench)
    refusal = ""
    try:
        bench.tell("arm")
    except PiezodError as error:
        refusal = str(error)
    watch.until(fault.expect.states, 1.0, fault.within_ms)
    watch.tell(seen)
    seen.text += refusal
    bench.heal()
    seen.armings = bench.rearms
    return seen


def disarmed(stand, fault, *, steps, wire="tcp", for_s=1.0):
    """Do the steps while nothing is driven."""
    bench = stand.bench(wire)
    seen = Seen()
    watch = Watch(bench)
    for step in steps:
        do(bench, step)
    time.sleep(for_s)
    watch.tell(seen)
    bench.stage.ask("idle", closes_after_s=0.0) if wire == "tcp" else None
    bench.heal()
    seen.armings = bench.rearms
    return seen


class Watch:
    """What a bench does from now on."""

    def __init__(self, bench):
        self.bench = bench
        self.said = len(bench.service.said)
        self.pid = bench.service.control_pid()
        self.descriptors, self.resident = _descriptors(self.pid), _resident_kib(self.pid)
        self.accepted = bench.stage.ask("report")["accepted"]
        self.parts = []
        bench.noted = {"pid": self.pid}
        self.last = bench.rows()[-1]
        self.begun_ns = bench.stage.ask("mark")["now_ns"]

    def until(self, states, for_s, within_ms):
        """Until one of the states has come, if it is not one that was there; then, or else, for a while."""
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

    def tell(self, seen):
        """Fill in state, time, figures and what was said."""
        seen.state = self._state()
        time.sleep(0.25)  # the parent looks ten times a second, and then writes its log
        self._state()
        rows = np.concatenate(self.parts) if self.parts else np.atleast_1d(self.last)
        report = self.bench.stage.ask("report")
        seen.wrong = report["wrong"]
        seen.text = self.bench.service.log(self.said)
        begun_ns = boot_ns(self.begun_ns)
        safe = first_row(rows, "RAMP_DOWN", "FAULT")
        if safe is not None:
            seen.after_ms = max(0.0, (ended_ns(rows[safe]) - begun_ns) / 1e6)
        seen.figures |= self._figures(rows, report, safe)

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
            "highest_V": report["highest_V"] or 0.0,
            "deeds": report["deeds"],
            "late_ms": report["late_ms"],
            "behind_ms": report["behind_ms"],
        }
        if safe is not None:
            figures["ticks_to_command"] = _ticks_to_command(rows, safe)
            before = good[good <= safe]
            last_ns = ended_ns(rows[before[-1]]) if before.size else boot_ns(self.begun_ns)
            figures["silence_ms"] = (ended_ns(rows[safe]) - last_ns) / 1e6
        if "commands" in self.bench.noted:
            figures["commands_afterwards"] = report["commands"] - self.bench.noted["commands"]
        if "cpu_percent" in self.bench.noted:
            figures["cpu_percent"] = self.bench.noted["cpu_percent"]
        if report["taken_over_ns"] is not None:
            figures["device_took_over_ms"] = (report["taken_over_ns"] - self.begun_ns) / 1e6
        return figures


def _ticks_to_command(rows, safe):
    """Ticks from the row that judged the fault to the first that commands less."""
    lower = np.flatnonzero(rows["voltage_V"][safe:] < rows["voltage_V"][safe] - 1e-6)
    return float(lower[0]) if lower.size else float("inf")


def _most_in(times_ms, width_ms):
    """The most times within a window."""
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


# what can be done ---------------------------------------------------------------------------------------------------


def do(bench, step):
    """One step."""
    ((name, arguments),) = step.items()
    return DOES[name](bench, arguments)


def _wire(bench, what):
    return bench.stage.ask("wire", what=what)


def _rules(bench, rules):
    return bench.stage.ask("rules", rules=list(rules))


def _flap(bench, arguments):
    for _ in range(arguments["times"]):
        _wire(bench, "refuse")
        time.sleep(arguments["off_s"])
        _wire(bench, "heal")
        time.sleep(arguments["on_s"])


def _stop_and_go(bench, arguments):
    """SIGSTOP to the process that drives, and SIGCONT after a while."""
    pid = bench.noted["pid"]
    for _ in range(arguments.get("times", 1)):
        os.kill(pid, signal.SIGSTOP)
        time.sleep(arguments["for_s"])
        bench.noted["commands"] = bench.stage.ask("report")["commands"]
        os.kill(pid, signal.SIGCONT)
        time.sleep(arguments.get("pause_s", 0.0))


def _load(bench, arguments):
    """Busy processes on every core, ended by their ids."""
    count = 2 * (os.cpu_count() or 1)
    program = "import os; os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))\nwhile True: pass"
    busy = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(count)]
    try:
        time.sleep(arguments["for_s"])
    finally:
        for process in busy:
            process.kill()
            process.wait()


def _write_beside(bench, arguments):
    """A client of its own writes the set point, straight to the device, so far above what the daemon wrote."""
    host, _, port = bench.stage.serves["direct"].rpartition(":")
    written_V = None
    with ModbusTcpClient(host, port=int(port), timeout=2) as client:
        end_s = time.monotonic() + arguments["for_s"]
        while time.monotonic() < end_s:
            words = client.read_holding_registers(100, count=2, device_id=1).registers
            found_V = struct.unpack(">f", struct.pack(">2H", *words))[0]
            if found_V == written_V:  # the daemon has not answered it yet
                continue
            written = struct.pack(">f", found_V + arguments["above_V"])
            written_V = struct.unpack(">f", written)[0]
            client.write_registers(100, list(struct.unpack(">2H", written)), device_id=1)


def _signals(bench, arguments):
    for _ in range(arguments.get("times", 1)):
        os.kill(bench.service.process.pid, getattr(signal, arguments["name"]))
        time.sleep(arguments.get("pause_s", 0.0))


def _edit(bench, arguments):
    """Change the configuration file, tell the daemon, and put the file back."""
    text = bench.path.read_text(encoding="utf-8")
    assert arguments["old"] in text, arguments["old"]
    bench.path.write_text(text.replace(arguments["old"], arguments["new"], 1), encoding="utf-8")
    os.kill(bench.service.process.pid, signal.SIGHUP)
    bench.service.wait_for("reload", within_s=5.0, since=len(bench.service.said) - 1)
    bench.path.write_text(text, encoding="utf-8")


def _clients(bench, arguments):
    """Clients of the control socket that say nothing, say too much, or never read."""
    path = str(bench.folder / "ring.sock")
    found = []
    for _ in range(arguments["count"]):
        client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        client.setblocking(False)
        client.connect(path)
        found.append(client)
        for chunk in arguments["sends"]:
            with contextlib.suppress(OSError):
                for _ in range(arguments.get("repeats", 1)):
                    client.send(chunk.encode("latin-1"))
    timer = threading.Timer(arguments["for_s"], lambda: [client.close() for client in found])
    timer.start()
    timer.join()


def _replug(bench, arguments):
    _wire(bench, "unplug")
    time.sleep(arguments["after_s"])
    _wire(bench, "plug")
    time.sleep(arguments["settle_s"])


def _measure_cpu(bench, arguments):
    """How much of a core the process that drives takes now [%]."""
    before_s = _cpu_s(bench.noted["pid"])
    time.sleep(arguments["for_s"])
    bench.noted["cpu_percent"] = 100.0 * (_cpu_s(bench.noted["pid"]) - before_s) / arguments["for_s"]


def _cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _trace(bench, arguments):
    """Have the kernel answer system calls of the process that drives with an error, now and then."""
    if shutil.which("strace") is None:
        raise CannotBeDoneHereError("strace is not installed")
    injected = [f"inject={calls}:error={error}:when={when}" for calls, error, when in arguments["inject"]]
    traced = ",".join(calls for calls, _, _ in arguments["inject"])
    tracer = subprocess.Popen(
        ["strace", "-qq", "-f", "-o", "/dev/null", "-e", f"trace={traced}",
         *(word for rule in injected for word in ("-e", rule)), "-p", str(bench.noted["pid"])],
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    time.sleep(arguments["for_s"])
    early = tracer.poll()
    if early is None:
        tracer.terminate()
    refusal = tracer.communicate(timeout=10)[1]
    if early is not None:
        raise CannotBeDoneHereError(f"strace cannot trace here: {refusal.strip()[:80]}")


DOES = {
    "rules": _rules,
    "wire": _wire,
    "lie": lambda bench, arguments: bench.stage.ask("lie", **arguments),
    "refuse": lambda bench, arguments: bench.stage.ask("refuse", **arguments),
    "deaf_to_writes": lambda bench, deaf: bench.stage.ask("deaf_to_writes", deaf=deaf),
    "fault_bits": lambda bench, bits: bench.stage.ask("fault_bits", bits=bits),
    "second_master": lambda bench, arguments: bench.stage.ask("second_master", **arguments),
    "idle": lambda bench, after_s: bench.stage.ask("idle", closes_after_s=after_s),
    "write_beside": _write_beside,
    "restart": lambda bench, _: bench.stage.ask("restart"),
    "flap": _flap,
    "stop_and_go": _stop_and_go,
    "load": _load,
    "signals": _signals,
    "edit": _edit,
    "clients": _clients,
    "replug": _replug,
    "measure_cpu": _measure_cpu,
    "trace": _trace,
    "wait_s": lambda _bench, duration_s: time.sleep(duration_s),
}

INJECTORS = {"running": running, "variants": variants, "arming": arming, "disarmed": disarmed}
