"""Faults of the daemon processes: signals, a second instance, missing rights, and files of an earlier daemon."""

import configparser
import os
import shutil
import signal
import time

from piezod.control import RingReader
from piezod.errors import PiezodError
from piezod.transport import make_link
from tests.faults.bench_pool import InjectionUnavailableError, Observation, run_piezod
from tests.faults.kills import Kills, kill
from tests.faults.live_bench import ROOT, Service
from tests.faults.running_faults import Watch, _descriptors, _resident_kib, do
from tests.unit.transport.conftest import tcp_config
from tests.unit.transport.scripted import ScriptedTcp

UNIT = ROOT / "systemd" / "piezod.service"


def signalled(pool, fault, *, signals, before=(), pause_s=0.05):
    """Send signals to a driving daemon; observes exit code and output voltage."""
    bench = pool.bench()
    bench.arm()
    for step in before:
        do(bench, step)
    watch, observed = Watch(bench), Observation()
    begun_s = time.monotonic()
    for k, name in enumerate(signals):
        if k:
            time.sleep(pause_s)
        os.kill(bench.service.process.pid, getattr(signal, name))
    observed.exit_code = bench.service.process.wait(timeout=30)
    ended_s = time.monotonic()
    observed.text = bench.service.log(watch.log_start)
    report = bench.device.ask("report")
    observed.wrong = report["wrong"]
    observed.after_ms = 1e3 * (ended_s - begun_s)
    observed.figures = {"output_V": abs(report["output_V"]), "taken_over": float(report["taken_over_ns"] is not None)}
    if report["rest_ns"]:
        observed.figures["rest_ms"] = report["rest_ns"] / 1e6 - 1e3 * begun_s
    bench.drop()
    observed.armings = bench.rearms
    return observed


def killed(pool, fault, *, how="SIGKILL", times=3):
    """Kill or stop the control process `times` times; the watchdog of the device makes it safe."""
    bench = pool.bench()
    found, usual_ms = Kills(how), 0.0
    if how == "SIGKILL":  # how long a start takes on this machine at this time, after an end in order
        bench.restore()
        bench.service.process.terminate()
        bench.service.process.wait()
        bench.drop()
        usual_ms = 1e3 * bench.start()
    for _ in range(times):
        kill(bench, how, found)
    messages = "" if bench.service is None else bench.service.log()
    bench.restore()
    found.armings = bench.rearms
    observed = Observation(after_ms=max(found.safe_ms), text=messages, wrong=found.wrong, armings=found.armings)
    observed.state = ("DISARMED" if how == "SIGKILL" else "FAULT") if found.disarmed == times else "another"
    observed.figures = {
        "times": found.times,
        "safe_in_time": found.safe,
        "rest_ms": max(found.rest_ms),
        "commands_afterwards": found.written_afterwards,
    }
    if found.ready_ms:
        observed.figures |= {
            "ready_ms": min(found.ready_ms),
            "ready_worst_ms": max(found.ready_ms),
            "usual_ready_ms": usual_ms,
        }
    return observed


def unfed_watchdog(pool, fault, *, for_s=1.0):
    """Stop the control process: notifications to systemd stop, and the watchdog of the device makes it safe."""
    bench = pool.bench()
    bench.arm()
    victim = bench.service.control_pid()
    bench.device.ask("mark")
    begun_s = time.monotonic()
    os.kill(victim, signal.SIGSTOP)
    time.sleep(0.4)  # the parent polls at 10 Hz and can still send one notification
    fed_before = sum(line == "WATCHDOG=1" for _, line in bench.service.notifications)
    time.sleep(for_s)
    fed = sum(line == "WATCHDOG=1" for _, line in bench.service.notifications) - fed_before
    report = bench.device.ask("report")
    observed = Observation(after_ms=report["taken_over_ns"] / 1e6 - 1e3 * begun_s, wrong=report["wrong"])
    observed.figures = {"fed_while_hung": fed, "fed_before": fed_before, "output_V": abs(report["output_V"])}
    bench.service.process.send_signal(signal.SIGABRT)  # the signal of systemd after WatchdogSec
    os.kill(victim, signal.SIGKILL)
    bench.service.process.wait(timeout=20)
    observed.exit_code = bench.service.process.returncode
    bench.drop()
    bench.restore()
    observed.armings = bench.rearms
    return observed


def crash_loop(pool, fault, *, times):
    """Kill the daemon at READY and start it again, `times` times."""
    bench = pool.bench()
    bench.device.ask("mark")
    begun_s = time.monotonic()
    observed = Observation()
    for _ in range(times):
        bench.start()
        child = bench.service.control_pid()
        os.kill(child, signal.SIGKILL)
        bench.service.process.kill()
        bench.service.process.wait()
        observed.text += bench.service.log()
        bench.drop()
    report = bench.device.ask("report")
    observed.wrong, observed.after_ms = report["wrong"], 1e3 * (time.monotonic() - begun_s) / times
    unit = _unit()
    observed.figures = {
        "times": times,
        "commands": report["commands"],
        "highest_V": report["highest_V"],
        "start_limit_burst": float(unit["Unit"]["StartLimitBurst"]),
        "start_limit_s": float(unit["Unit"]["StartLimitIntervalSec"]),
    }
    bench.restore()
    observed.armings = bench.rearms
    return observed


def _unit():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(UNIT, encoding="utf-8")
    return unit


def out_of_memory(pool, fault, *, times=1):
    """Kill as the kernel does when out of memory, and read the memory limit of the unit."""
    observed = killed(pool, fault, how="SIGKILL", times=times)
    service = _unit()["Service"]
    observed.figures["memory_max_bytes"] = 2.0**30 * float(service["MemoryMax"].rstrip("G"))
    observed.text += f"\nOOMPolicy={service['OOMPolicy']}"
    return observed


def second_instance(pool, fault):
    """Start a second daemon for the same bench."""
    bench = pool.bench()
    bench.device.ask("mark")
    code, text, after_ms = run_piezod("run", bench.path)
    observed = Observation(bench.status()["state"], code, text, after_ms, wrong=bench.device.ask("report")["wrong"])
    observed.figures["names_the_holder"] = float(f"process {bench.service.process.pid}" in text)
    return observed


def reconnected(pool, fault, *, times):
    """Reconnect after every exchange, and count open descriptors and memory."""
    bad = 0
    with ScriptedTcp() as server:
        link = make_link(tcp_config(server.port, registers=_small()))
        link.open()
        link.poll()
        before, resident = _descriptors(os.getpid()), _resident_kib(os.getpid())
        begun_s = time.monotonic()
        for _ in range(times):
            link.close()
            try:
                link.open()
            except PiezodError:
                bad += 1
                continue
            bad += link.poll() != 0
        after_s = time.monotonic() - begun_s
        observed = Observation(after_ms=1e3 * after_s / times)
        observed.figures = {
            "times": times,
            "descriptors_grown": _descriptors(os.getpid()) - before,
            "resident_grown_kib": _resident_kib(os.getpid()) - resident,
            "bad": bad,
        }
        link.close()
    return observed


def _small():
    from tests.unit.transport.scripted import registers

    return registers()


def long_run(pool, fault, *, for_s):
    """Drive for `for_s` and observe the growth of memory."""
    bench = pool.bench()
    bench.arm()
    time.sleep(1.0)
    watch, observed = Watch(bench), Observation()
    time.sleep(for_s)
    watch.finish(observed)
    bench.restore()
    observed.armings = bench.rearms
    return observed


def without_rights(pool, fault):
    """Start without the right to real-time priority."""
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        raise InjectionUnavailableError("needs root and setpriv to drop the right")
    bench = pool.bench()
    bench.service.end()
    bench.drop()
    prefix = ["prlimit", "--rtprio=0:0", "setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice"]
    service = Service(bench.path, prefix=prefix)
    try:
        ready_s = service.wait_notification("READY=1")
        service.wait_for("reading only")
        code = service.end()
        observed = Observation("DISARMED", code, service.log(), 1e3 * ((ready_s or 1e9) - service.begun_s))
    finally:
        service.close()
    bench.restore()
    return observed


def other_version(pool, fault):
    """Read a ring log, a configuration and a model of another version."""
    bench = pool.bench()
    folder = pool.new_folder()
    messages = []
    ring = folder / "ring"
    ring.write_bytes((bench.folder / "ring").read_bytes().replace(b"PIEZRNG1", b"PIEZRNG2", 1))
    try:
        RingReader(ring)
    except PiezodError as error:
        messages.append(str(error))
    begun_s = time.monotonic()
    text = bench.path.read_text(encoding="utf-8")
    (folder / "bench.yaml").write_text(text.replace("piezod.bench/1", "piezod.bench/2", 1), encoding="utf-8")
    code, output, _ = run_piezod("run", folder / "bench.yaml")
    messages.append(output)
    model = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
    (folder / "model.yaml").write_text(model.replace("piezod.model/1", "piezod.model/2", 1), encoding="utf-8")
    (folder / "bench.yaml").write_text(
        text.replace(str(ROOT / "config" / "model.yaml"), str(folder / "model.yaml"), 1), encoding="utf-8"
    )
    with_daemon = bench.status()["state"]
    bench.service.end()
    bench.drop()
    code_of_model, output, _ = run_piezod("run", folder / "bench.yaml", "--arm")
    messages.append(output)
    observed = Observation(with_daemon, code, "\n".join(messages), 1e3 * (time.monotonic() - begun_s))
    observed.figures = {"exit_code_for_the_model": code_of_model, "refused": len(messages)}
    bench.restore()
    return observed


INJECTORS = {
    "signalled": signalled,
    "killed": killed,
    "unfed_watchdog": unfed_watchdog,
    "crash_loop": crash_loop,
    "out_of_memory": out_of_memory,
    "second_instance": second_instance,
    "reconnected": reconnected,
    "long_run": long_run,
    "without_rights": without_rights,
    "other_version": other_version,
}
