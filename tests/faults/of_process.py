"""Faults of the daemon's processes: ended, stopped, started twice, starved of rights; and of what it leaves behind."""

import configparser
import os
import shutil
import signal
import socket
import time
from pathlib import Path

from piezod.control import RingReader
from piezod.errors import PiezodError
from piezod.transport import make_link
from tests.faults.at_work import Watch, _descriptors, _resident_kib, do
from tests.faults.kills import Kills, kill
from tests.faults.live import ROOT, Service
from tests.faults.stand import CannotBeDoneHereError, Seen, apart
from tests.unit.transport.conftest import tcp_config
from tests.unit.transport.scripted import ScriptedTcp

UNIT = ROOT / "systemd" / "piezod.service"


def ended_by(stand, fault, *, signals, before=(), pause_s=0.05):
    """Signals to a daemon that drives: exit code, and the output at rest."""
    bench = stand.bench()
    bench.arm()
    for step in before:
        do(bench, step)
    watch, seen = Watch(bench), Seen()
    begun_s = time.monotonic()
    for k, name in enumerate(signals):
        if k:
            time.sleep(pause_s)
        os.kill(bench.service.process.pid, getattr(signal, name))
    seen.exit_code = bench.service.process.wait(timeout=30)
    ended_s = time.monotonic()
    seen.text = bench.service.log(watch.said)
    report = bench.stage.ask("report")
    seen.wrong = report["wrong"]
    seen.after_ms = 1e3 * (ended_s - begun_s)
    seen.figures = {"output_V": abs(report["output_V"]), "taken_over": float(report["taken_over_ns"] is not None)}
    if report["rest_ns"]:
        seen.figures["rest_ms"] = report["rest_ns"] / 1e6 - 1e3 * begun_s
    bench.drop()
    seen.armings = bench.rearms
    return seen


def killed(stand, fault, *, how="SIGKILL", times=3):
    """The process that drives is killed or stopped, so many times: the device is safe by itself; all begins anew."""
    bench = stand.bench()
    found = Kills(how)
    for _ in range(times):
        kill(bench, how, found)
    said = "" if bench.service is None else bench.service.log()
    bench.heal()
    found.armings = bench.rearms
    seen = Seen(after_ms=max(found.safe_ms), text=said, wrong=found.wrong, armings=found.armings)
    seen.state = ("DISARMED" if how == "SIGKILL" else "FAULT") if found.disarmed == times else "another"
    seen.figures = {
        "times": found.times,
        "safe_in_time": found.safe,
        "rest_ms": max(found.rest_ms),
        "commands_afterwards": found.written_afterwards,
    }
    if found.ready_ms:
        seen.figures |= {"ready_ms": min(found.ready_ms), "ready_worst_ms": max(found.ready_ms)}
    return seen


def safe_stop(stand, fault):
    """The daemon is killed, and what ExecStopPost runs comes after it."""
    bench = stand.bench()
    bench.arm()
    victim, parent = bench.service.control_pid(), bench.service.process
    bench.stage.ask("mark")
    begun_s = time.monotonic()
    os.kill(victim, signal.SIGKILL)
    parent.kill()
    parent.wait()
    bench.drop()
    code, text, _ = apart("stop", bench.path, "--direct")
    report = bench.stage.ask("report")
    seen = Seen("", code, text, 1e3 * (time.monotonic() - begun_s), wrong=report["wrong"])
    seen.figures = {"output_V": abs(report["output_V"]), "times": 1}
    bench.heal()
    seen.armings = bench.rearms
    return seen


def unfed_watchdog(stand, fault, *, for_s=1.0):
    """The loop hangs: systemd hears nothing any more, aborts the service, and the device is safe by itself."""
    bench = stand.bench()
    bench.arm()
    victim = bench.service.control_pid()
    bench.stage.ask("mark")
    begun_s = time.monotonic()
    os.kill(victim, signal.SIGSTOP)
    time.sleep(0.4)  # the parent looks ten times a second; what it had seen before it may still tell
    heard = sum(line == "WATCHDOG=1" for _, line in bench.service.told)
    time.sleep(for_s)
    fed = sum(line == "WATCHDOG=1" for _, line in bench.service.told) - heard
    report = bench.stage.ask("report")
    seen = Seen(after_ms=report["taken_over_ns"] / 1e6 - 1e3 * begun_s, wrong=report["wrong"])
    seen.figures = {"fed_while_hung": fed, "fed_before": heard, "output_V": abs(report["output_V"])}
    bench.service.process.send_signal(signal.SIGABRT)  # what systemd sends after WatchdogSec
    os.kill(victim, signal.SIGKILL)
    bench.service.process.wait(timeout=20)
    seen.exit_code = bench.service.process.returncode
    bench.drop()
    bench.heal()
    seen.armings = bench.rearms
    return seen


def crash_loop(stand, fault, *, times):
    """Killed as soon as it is ready, again and again, as systemd would start it again."""
    bench = stand.bench()
    bench.stage.ask("mark")
    begun_s = time.monotonic()
    seen = Seen()
    for _ in range(times):
        bench.start()
        child = bench.service.control_pid()
        os.kill(child, signal.SIGKILL)
        bench.service.process.kill()
        bench.service.process.wait()
        seen.text += bench.service.log()
        bench.drop()
    report = bench.stage.ask("report")
    seen.wrong, seen.after_ms = report["wrong"], 1e3 * (time.monotonic() - begun_s) / times
    unit = _unit()
    seen.figures = {
        "times": times,
        "commands": report["commands"],
        "highest_V": report["highest_V"],
        "start_limit_burst": float(unit["Unit"]["StartLimitBurst"]),
        "start_limit_s": float(unit["Unit"]["StartLimitIntervalSec"]),
    }
    bench.heal()
    seen.armings = bench.rearms
    return seen


def _unit():
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str
    unit.read(UNIT, encoding="utf-8")
    return unit


def out_of_memory(stand, fault, *, times=1):
    """What the kernel does then: SIGKILL, to whoever is the largest; and the unit that bounds it."""
    seen = killed(stand, fault, how="SIGKILL", times=times)
    service = _unit()["Service"]
    seen.figures["memory_max_bytes"] = 2.0**30 * float(service["MemoryMax"].rstrip("G"))
    seen.text += f"\nOOMPolicy={service['OOMPolicy']}"
    return seen


def second_instance(stand, fault):
    """The same bench, once more."""
    bench = stand.bench()
    bench.stage.ask("mark")
    code, text, after_ms = apart("run", bench.path)
    seen = Seen(bench.status()["state"], code, text, after_ms, wrong=bench.stage.ask("report")["wrong"])
    seen.figures["names_the_holder"] = float(f"process {bench.service.process.pid}" in text)
    return seen


def left_behind(stand, fault):
    """Lock, socket and ring log of a daemon that is gone."""
    bench = stand.bench()
    bench.service.end()
    bench.drop()
    ring = bench.folder / "ring"
    ring.write_bytes(b"PIEZRNG0 of another time" * 10)
    Path(f"{ring}.lock").write_text("1\n", encoding="ascii")  # process 1 lives, and holds nothing
    stale = socket.socket(socket.AF_UNIX)
    stale.bind(f"{ring}.sock")
    stale.close()
    ready_s = bench.start()
    seen = Seen(bench.status()["state"], text=bench.service.log(), after_ms=1e3 * ready_s)
    bench.heal()
    return seen


def reconnected(stand, fault, *, times):
    """A device that hangs up after every exchange: how many descriptors are left over."""
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
        seen = Seen(after_ms=1e3 * after_s / times)
        seen.figures = {
            "times": times,
            "descriptors_grown": _descriptors(os.getpid()) - before,
            "resident_grown_kib": _resident_kib(os.getpid()) - resident,
            "bad": bad,
        }
        link.close()
    return seen


def _small():
    from tests.unit.transport.scripted import registers

    return registers()


def at_length(stand, fault, *, for_s):
    """The daemon at work for a while: does its memory grow?"""
    bench = stand.bench()
    bench.arm()
    time.sleep(1.0)
    watch, seen = Watch(bench), Seen()
    time.sleep(for_s)
    watch.tell(seen)
    bench.heal()
    seen.armings = bench.rearms
    return seen


def without_rights(stand, fault):
    """No real-time priority is granted."""
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        raise CannotBeDoneHereError("needs root and setpriv, to give the right away")
    bench = stand.bench()
    bench.service.end()
    bench.drop()
    prefix = ["prlimit", "--rtprio=0:0", "setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice"]
    service = Service(bench.path, prefix=prefix)
    try:
        ready_s = service.wait_told("READY=1")
        service.wait_for("reading only")
        code = service.end()
        seen = Seen("DISARMED", code, service.log(), 1e3 * ((ready_s or 1e9) - service.begun_s))
    finally:
        service.close()
    bench.heal()
    return seen


def other_version(stand, fault):
    """What another version left: a ring log, a configuration, a model."""
    bench = stand.bench()
    folder = stand.new_folder()
    said = []
    ring = folder / "ring"
    ring.write_bytes((bench.folder / "ring").read_bytes().replace(b"PIEZRNG1", b"PIEZRNG2", 1))
    try:
        RingReader(ring)
    except PiezodError as error:
        said.append(str(error))
    begun_s = time.monotonic()
    text = bench.path.read_text(encoding="utf-8")
    (folder / "bench.yaml").write_text(text.replace("piezod.bench/1", "piezod.bench/2", 1), encoding="utf-8")
    code, told, _ = apart("run", folder / "bench.yaml")
    said.append(told)
    model = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
    (folder / "model.yaml").write_text(model.replace("piezod.model/1", "piezod.model/2", 1), encoding="utf-8")
    (folder / "bench.yaml").write_text(
        text.replace(str(ROOT / "config" / "model.yaml"), str(folder / "model.yaml"), 1), encoding="utf-8"
    )
    with_daemon = bench.status()["state"]
    bench.service.end()
    bench.drop()
    code_of_model, told, _ = apart("run", folder / "bench.yaml", "--arm")
    said.append(told)
    seen = Seen(with_daemon, code, "\n".join(said), 1e3 * (time.monotonic() - begun_s))
    seen.figures = {"exit_code_for_the_model": code_of_model, "refused": len(said)}
    bench.heal()
    return seen


INJECTORS = {
    "ended_by": ended_by,
    "killed": killed,
    "safe_stop": safe_stop,
    "unfed_watchdog": unfed_watchdog,
    "crash_loop": crash_loop,
    "out_of_memory": out_of_memory,
    "second_instance": second_instance,
    "left_behind": left_behind,
    "reconnected": reconnected,
    "at_length": at_length,
    "without_rights": without_rights,
    "other_version": other_version,
}
