"""Faults of access: crowds at the control socket, foreign files, a full file system, a umask, a shared device."""

import contextlib
import os
import shutil
import stat
import subprocess
import sys
import threading
import time

import yaml

from tests.faults.bench_pool import InjectionUnavailableError, Observation, run_piezod
from tests.faults.live_bench import DAEMON_ROOT, LiveBench

PRECIOUS = "time_s,voltage_V,force_N\n0.0,0.0,0.0\n0.01,1.0,2.0\n"


def existing_files(pool, fault, *, places):
    """Start with one path after the other that names a file of somebody else; every file must stay as it is.

    Parameters
    ----------
    places
        Names out of `_PLACES`.
    """
    bench = pool.bench()
    bench.service.end()
    bench.drop()
    codes, texts, intact, begun_s = [], [], 0, time.monotonic()
    bench.device.ask("mark")
    for place in places:
        folder = pool.new_folder()
        content = yaml.safe_load(bench.path.read_text(encoding="utf-8"))
        content["daemon"]["ring_log"] = str(folder / "ring")
        file = folder / "precious"
        _PLACES[place](content, file)
        named = folder / f"precious{'.lock' if place == 'lock' else ''}"
        named.write_text(PRECIOUS, encoding="utf-8")
        (folder / "bench.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        with _running(folder / "bench.yaml") as process:
            codes.append(process.wait())
            texts.append(process.stderr.read())
        intact += named.is_file() and named.read_text(encoding="utf-8") == PRECIOUS
    observed = Observation("none", min(codes, key=lambda code: code == 78), "\n".join(texts))
    observed.after_ms = 1e3 * (time.monotonic() - begun_s)
    observed.figures = {
        "intact": intact,
        "lines": sum(line.startswith("piezod: ") for text in texts for line in text.splitlines()),
        "commands": bench.device.ask("report")["commands"],
    }
    bench.restore()
    return observed


@contextlib.contextmanager
def _running(path, longest_s=12.0):
    """`piezod run`, ended by SIGTERM after `longest_s` if it accepts its configuration."""
    process = subprocess.Popen(
        [sys.executable, "-m", "piezod", "run", str(path)],
        stderr=subprocess.PIPE, text=True, cwd=DAEMON_ROOT,
    )  # fmt: skip
    timer = threading.Timer(longest_s, process.terminate)
    timer.start()
    try:
        yield process
    finally:
        timer.cancel()
        process.stderr.close()


def _name_ring_log(content, file):
    content["daemon"]["ring_log"] = str(file)


def _name_socket(content, file):
    content["daemon"]["socket"] = str(file)


def _name_stream(content, file):
    content["reference"] = {"kind": "stream", "listen": str(file)}


def _name_drift_file(content, file):
    content["drift"] = {"file": str(file)}


_PLACES = {
    "ring_log": _name_ring_log,
    "lock": _name_ring_log,
    "socket": _name_socket,
    "listen": _name_stream,
    "drift": _name_drift_file,
}


def full_file_system(pool, fault, *, size):
    """Start with the ring log on a tmpfs that is too small for it."""
    if os.geteuid() != 0 or shutil.which("mount") is None:
        raise InjectionUnavailableError("needs root and mount")
    bench = pool.bench()
    bench.service.end()
    bench.drop()
    folder = pool.new_folder()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode != 0:
        raise InjectionUnavailableError(f"no tmpfs here: {made.stderr.strip()[:80]}")
    try:
        content = yaml.safe_load(bench.path.read_text(encoding="utf-8"))
        content["daemon"]["ring_log"] = str(folder / "ring")
        path = pool.new_folder() / "bench.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        bench.device.ask("mark")
        code, text, after_ms = run_piezod("run", path, "--arm")
        stop_code, stop_text, _ = run_piezod("stop", path, "--direct")
        left = len(list(folder.iterdir()))
    finally:
        subprocess.run(["umount", str(folder)], capture_output=True, check=False)
    observed = Observation("none", code, text + stop_text, after_ms)
    observed.figures = {
        "lines": sum(line.startswith("piezod: ") for line in text.splitlines()),
        "stop_exit_code": stop_code,
        "files_left": left,
        "commands": bench.device.ask("report")["commands"],
    }
    bench.restore()
    return observed


def masked(pool, fault, *, umask):
    """Start with a umask, and read the modes of the run-time files."""
    folder = pool.new_folder()
    bench = LiveBench(folder, None, {"reference": {"kind": "stream", "listen": str(folder / "stream")}})
    before = os.umask(umask)
    try:
        begun_s = time.monotonic()
        bench.start()
        observed = Observation(bench.status()["state"], after_ms=1e3 * (time.monotonic() - begun_s))
    finally:
        os.umask(before)
    try:
        for name, key in (("ring", "ring_log"), ("ring.lock", "lock"), ("ring.sock", "socket"), ("stream", "stream")):
            found = (folder / name).stat()
            observed.figures[key] = float(f"{stat.S_IMODE(found.st_mode):o}")
    finally:
        bench.close()
    return observed


INJECTORS = {
    "existing_files": existing_files,
    "full_file_system": full_file_system,
    "masked": masked,
}
