"""Faults between the daemon and its control process: late commands, a dead parent, and configurations read again."""

import contextlib
import json
import os
import signal
import socket
import time
from pathlib import Path

import yaml

from piezod.errors import PiezodError, TemporaryError
from tests.faults.bench_pool import Observation, run_piezod
from tests.faults.live_bench import ROOT, LiveBench
from tests.faults.running_faults import Watch, busy_machine

POLL_S = 0.02
WITHOUT_WATCHDOG = {
    "limits": {"device_watchdog_ms": 0},
    "arming": {"without": ["device_watchdog"]},
}


def reloaded_while_starting(pool, fault, *, old, first, second, for_s):
    """Reload twice; the second time while the control process starts with the configuration of the first."""
    bench = pool.bench()
    text = bench.path.read_text(encoding="utf-8")
    observed = Observation()
    try:
        _write(bench, text, old, first)
        bench.send_command("reload")
        _wait(lambda: not bench.status()["connected"])
        _write(bench, text, old, second)
        for _ in range(200):
            try:
                bench.send_command("reload")
                break
            except TemporaryError as error:
                observed.text += f"{error}\n"
                time.sleep(POLL_S)
        _wait(lambda: bench.status()["connected"])
        time.sleep(0.2)
        bench.reopen_ring()
        watch = Watch(bench)
        bench.send_command("arm")
        watch.until(fault.expect.states, for_s, fault.within_ms)
        said = observed.text
        watch.finish(observed)
        observed.text += said
    finally:
        bench.path.write_text(text, encoding="utf-8")
    _start_anew(bench)
    observed.armings = bench.rearms
    return observed


def reloaded_while_driving(pool, fault, *, changes, key, from_, step, every_s, for_s):
    """Tighten the limit `key` by `step` every `every_s` while the reference is followed."""
    bench = pool.bench(**changes)
    text = bench.path.read_text(encoding="utf-8")
    observed = Observation()
    bench.arm(settle_s=0.0)
    watch = Watch(bench)
    try:
        value, taken, end_s = from_, 0, time.monotonic() + for_s
        while time.monotonic() < end_s and bench.status()["state"] == "RUNNING":
            _write(bench, text, f"{key}: {from_}", f"{key}: {value - step}")
            value -= step
            with contextlib.suppress(PiezodError):  # the state may have changed since
                bench.send_command("reload")
                taken += 1
            time.sleep(every_s)
        watch.until(fault.expect.states, 0.0, 1000.0)
        watch.finish(observed)
        observed.figures["reloads"] = taken
    finally:
        bench.path.write_text(text, encoding="utf-8")
    _start_anew(bench)
    observed.armings = bench.rearms
    return observed


def reloaded_between_two_drives(pool, fault, *, changes, old, new, drive_s):
    """Drive, disarm, reload, and drive again: the stack is still warm."""
    bench = pool.bench(**changes)
    text = bench.path.read_text(encoding="utf-8")
    observed = Observation()
    try:
        bench.arm(settle_s=drive_s)
        bench.send_command("disarm")
        bench.wait_state("DISARMED")
        _write(bench, text, old, new)
        bench.send_command("reload")
        _wait(lambda: not bench.status()["connected"])
        _wait(lambda: bench.status()["connected"])
        time.sleep(0.2)
        bench.reopen_ring()
        watch = Watch(bench)
        bench.send_command("arm")
        watch.until(fault.expect.states, 0.0, fault.within_ms)
        watch.finish(observed)
    finally:
        bench.path.write_text(text, encoding="utf-8")
    _start_anew(bench)
    observed.armings = bench.rearms
    return observed


def armed_with_late_replies(pool, fault, *, late_s, clear_after_s, for_s):
    """Arm while every reply is late; the replies are prompt again after the daemon has reported a failure."""
    bench = pool.bench(link={"timeout_s": 3.0, "heartbeat_within_s": 10.0})
    observed = Observation()
    watch = Watch(bench)
    bench.device.ask("rules", rules=[{"do": "delay", "by": late_s, "count": 0}])
    begun_s = time.monotonic()
    try:
        bench.send_command("arm")
        observed.exit_code = 0
    except PiezodError as error:
        observed.exit_code = error.exit_code
        observed.text = str(error)
    reported_s = time.monotonic() - begun_s
    said = observed.text
    time.sleep(max(0.0, clear_after_s - reported_s))
    bench.device.ask("rules", rules=[])
    time.sleep(for_s)
    watch.finish(observed)
    observed.text += said
    observed.figures |= {"reported_s": reported_s, "output_V": bench.device.ask("report")["output_V"]}
    bench.restore()
    observed.armings = bench.rearms
    return observed


def armed_without_reference(pool, fault, *, wait_s):
    """Arm a bench whose stream has no sender, and wait until it is disarmed, at most `wait_s`."""
    bench = pool.bench(reference={"kind": "stream", "listen": str(pool.folder / "stream"), "when_stale": "ramp_down"})
    watch, observed = Watch(bench), Observation()
    bench.send_command("arm")
    end_s = time.monotonic() + wait_s
    while bench.status()["state"] != "DISARMED" and time.monotonic() < end_s:
        time.sleep(0.1)
    watch.finish(observed)
    observed.figures["timeouts"] = observed.text.count("limits.arming_timeout_s")
    observed.figures["output_V"] = abs(bench.device.ask("report")["output_V"])
    bench.send_command("disarm")
    bench.restore()
    observed.armings = bench.rearms
    return observed


def reference_out_of_reach(pool, fault, *, reference, wait_s):
    """Follow a reference that the voltage range does not reach."""
    bench = pool.bench(reference=reference)
    observed, begun = Observation(), len(bench.service.log_lines)
    bench.arm(settle_s=0.0)
    watch = Watch(bench)
    time.sleep(wait_s)
    observed.figures["railed"] = float(bench.status().get("rail", {}).get("railed", False))
    watch.finish(observed)
    observed.text = bench.service.log(begun)
    observed.figures["lines"] = observed.text.count("RAILED")
    bench.restore()
    observed.armings = bench.rearms
    return observed


def armed_on_a_cold_cache(pool, fault, *, effect):
    """Start with an empty cache of compiled steps on a busy machine, and arm as soon as the daemon reports READY."""
    folder = pool.new_folder()
    model = yaml.safe_load((ROOT / "config" / "model.yaml").read_text(encoding="utf-8"))
    (folder / "model.yaml").write_text(yaml.safe_dump(model | {"effects": [effect]}), encoding="utf-8")
    bench = LiveBench(folder / "bench", changes={"model": str(folder / "model.yaml")})
    observed = Observation()
    try:
        with busy_machine():
            bench.environment = {"NUMBA_CACHE_DIR": str(folder)}
            ready_s = bench.start(within_s=120.0)  # the steps are compiled
            begun_s = time.monotonic()
            try:
                bench.send_command("arm")
            except PiezodError as error:
                observed.text = str(error)
        with contextlib.suppress(AssertionError):
            bench.wait_state("RUNNING", within_s=10.0)
        observed.after_ms = 1e3 * (time.monotonic() - begun_s)
        observed.state = bench.status()["state"]
        observed.figures = {"ready_s": ready_s}
        observed.text += bench.service.log()
        observed.armings = bench.rearms
    finally:
        bench.close()
    return observed


def parent_killed(pool, fault, *, changes=None, terms=0, command=None, before_s=0.3):
    """Kill the daemon with SIGKILL while its control process drives.

    Parameters
    ----------
    terms
        Number of further SIGTERM to the control process: the kernel may send the parent-death signal repeatedly.
    command
        Command that waits in the pipe when the daemon dies; the control process is stopped meanwhile.
    """
    changes = WITHOUT_WATCHDOG if changes is None else {**WITHOUT_WATCHDOG, **changes}
    bench = pool.bench(**changes)
    bench.arm(settle_s=before_s)
    victim, parent = bench.service.control_pid(), bench.service.process
    observed = Observation()
    bench.device.ask("mark")
    begun_V, begun_s = bench.device.ask("report")["output_V"], time.monotonic()
    if command is not None:
        os.kill(victim, signal.SIGSTOP)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
            client.connect(str(bench.folder / "ring.sock"))
            client.sendall(json.dumps({"command": command}).encode() + b"\n")
            time.sleep(0.05)
    parent.kill()
    parent.wait()
    for _ in range(terms):
        time.sleep(0.01)
        os.kill(victim, signal.SIGTERM)
    if command is not None:
        os.kill(victim, signal.SIGCONT)
    report = _await_rest(bench, within_s=fault.within_ms / 1e3)
    ramp_s = report["rest_ns"] / 1e9 - begun_s if report["rest_ns"] else float("inf")
    observed.after_ms = 1e3 * ramp_s if report["rest_ns"] else 0.0
    observed.text = bench.service.log()
    observed.wrong = report["wrong"]
    observed.figures = {
        "output_V": abs(report["output_V"]),
        "ramp_V_per_s": begun_V / ramp_s,
        "processes_left": float(_lives(victim)),
    }
    bench.drop()
    if abs(report["output_V"]) > 0.5:
        run_piezod("stop", bench.path, "--direct")
    bench.restore()
    observed.armings = bench.rearms
    return observed


def reset_off_rest(pool, fault, *, wait_s=1.0):
    """Reset a fault whose output still stands at the held voltage."""
    bench = pool.bench(
        limits=WITHOUT_WATCHDOG["limits"] | {"comm_loss_action": "hold"}, arming=WITHOUT_WATCHDOG["arming"]
    )
    bench.arm()
    watch, observed = Watch(bench), Observation()
    bench.device.ask("wire", what="refuse")
    watch.until(("FAULT",), 0.0, 1000.0)
    bench.device.ask("wire", what="restore")
    time.sleep(wait_s)
    try:
        bench.send_command("reset")
        observed.exit_code = 0
    except PiezodError as error:
        observed.exit_code, observed.text = error.exit_code, str(error)
    said = observed.text
    watch.finish(observed)
    observed.text += said
    observed.figures["output_V"] = abs(bench.device.ask("report")["output_V"])
    bench.service.end()
    bench.drop()
    run_piezod("stop", bench.path, "--direct")
    bench.restore()
    observed.armings = bench.rearms
    return observed


def _write(bench, text, old, new):
    assert old in text, old
    bench.path.write_text(text.replace(old, new, 1), encoding="utf-8")


def _wait(condition, within_s=20.0):
    deadline_s = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise AssertionError("the control process did not start again")
        time.sleep(0.005)


def _start_anew(bench):
    """End the daemon and start it with the configuration file as it is now."""
    bench.service.end()
    bench.drop()
    bench.restore()


def _await_rest(bench, within_s):
    deadline_s = time.monotonic() + within_s + 0.5
    while not (report := bench.device.ask("report"))["rest_ns"] and time.monotonic() < deadline_s:
        time.sleep(POLL_S)
    return report


def _lives(pid, within_s=3.0):
    deadline_s = time.monotonic() + within_s
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline_s:
        time.sleep(POLL_S)
    return Path(f"/proc/{pid}").exists()


INJECTORS = {
    "reference_out_of_reach": reference_out_of_reach,
    "armed_without_reference": armed_without_reference,
    "reloaded_while_starting": reloaded_while_starting,
    "reloaded_while_driving": reloaded_while_driving,
    "reloaded_between_two_drives": reloaded_between_two_drives,
    "armed_with_late_replies": armed_with_late_replies,
    "armed_on_a_cold_cache": armed_on_a_cold_cache,
    "parent_killed": parent_killed,
    "reset_off_rest": reset_off_rest,
}
