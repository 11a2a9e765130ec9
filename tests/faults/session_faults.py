"""Faults between the daemon and its control process: late commands, a dead parent, and configurations read again."""

import contextlib
import json
import os
import signal
import socket
import time
from pathlib import Path

import yaml

from piezod.errors import PiezodError
from tests.faults.bench_pool import Observation, run_piezod
from tests.faults.live_bench import ROOT, LiveBench
from tests.faults.running_faults import busy_machine

POLL_S = 0.02
WITHOUT_WATCHDOG = {
    "limits": {"device_watchdog_ms": 0},
    "arming": {"without": ["device_watchdog"]},
}


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
    "armed_on_a_cold_cache": armed_on_a_cold_cache,
    "parent_killed": parent_killed,
}
