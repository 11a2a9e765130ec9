"""Each command that drives, and each event that must end it: time until the output is at rest, and what the disk keeps.

    python -m pytest -n 0 -m slow -s tests/end_to_end/test_verbs_and_events.py      # prints the table

The emulated device measures the voltage and the time at its physics steps, from the event on. The limit of the time is
the ramp of that event from the voltage at it, and a margin; a killed process leaves the output to the watchdog of the
device. `kept` is the driven time that the files of the command hold, `driven` that of the ticks before the event.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass

import pytest
import yaml

from piezod.config import load_bench
from piezod.daemon.client import Client, command_and_wait
from piezod.errors import PiezodError
from piezod.recording import read_recording
from tests.benches.processes import Popen
from tests.faults.bench_pool import raised_priority
from tests.faults.live_bench import RATE_HZ, ROOT, TIMING, LiveBench
from tests.studies.powercut import fill, small_folder

WITHIN_S = 60.0  # of a start and of an end, which are not measured
DRIVEN_TICKS = 300  # before the event
LOST_S = 0.05  # of rows, whatever ends the command
KEPT_WITHIN_S = 10.0  # of the recorder of a killed command, which goes on until rest
MARGIN_MS = 500.0  # of an event loop and a socket on a busy machine; a stop under a blockade has the same
RAMPS_V_PER_S = {"fast": 800.0, "slow": 400.0}  # slew and ramp down of the bench file
PATIENT = {  # with other work on the machine: what is judged is the ramp, not the tick
    "link": {"timeout_s": 0.05, "heartbeat_within_s": 0.05},
    "limits": {"stale_after_ms": 150, "missed_ticks_in_a_row": 500},
}
MODEL = str(ROOT / "config" / "model.yaml")
SEQUENCE = {
    "schema": "piezod.sequence/1",
    "name": "long",
    "steps": [
        {
            "name": "slow",
            "reference": {
                "kind": "triangle",
                "amplitude_N": 40,
                "offset_N": 120,
                "frequency_Hz": 0.5,
                "duration_s": 90,
            },
            "limits": {"rms_error_N": 20.0},
        }
    ],
}
VERBS = {
    "run": ["run", "{bench}"],
    "record": ["record", "{bench}", "--excitation", "constant-triangles", "--peak", "60", "--frequency", "0.5",
               "--periods", "100", "-o", "{out}/recording.csv"],
    "sequence": ["run", "{bench}", "--sequence", "{folder}/long.yaml", "--arm", "-o", "{out}/run"],
    "validate": ["validate", "{bench}", "--model", MODEL, "--report", "{out}/validation.html"],
    "commission": ["commission", "{bench}", "-o", "{out}/commission", "--frequency", "0.5"],
    "investigate": ["investigate", "{bench}", "--model", MODEL, "--yes", "-o", "{out}/investigation"],
    "proof": ["check", "{bench}", "--proof", "-o", "{out}/proof.json"],
}  # fmt: skip


@dataclass
class Found:
    """What one event did to one command.

    Parameters
    ----------
    voltage_V
        Output at the event [V].
    rest_ms, limit_ms
        Time from the event to rest and its limit [ms]; infinite if it never came, None where none is due.
    code
        Exit code; negative: the signal that ended it; None: it went on.
    driven_s, kept_s
        Driven before the event, and held by its files [s].
    files
        Names of the files left.
    """

    verb: str
    event: str
    voltage_V: float
    rest_ms: float
    limit_ms: float | None
    code: int | None
    driven_s: float
    kept_s: float
    files: list[str]
    said: str

    def line(self):
        limit = "-" if self.limit_ms is None else f"{self.limit_ms:.0f}"
        return (
            f"{self.verb:<11} {self.event:<16} {self.voltage_V:6.1f} {self.rest_ms:8.0f} {limit:>6} {self.code!s:>5} "
            f"{self.driven_s:7.2f} {self.kept_s:7.2f}  {' '.join(self.files)[:60]}  {self.said[:80]}"
        )


HEADER = (
    f"{'verb':<11} {'event':<16} {'at [V]':>6} {'rest[ms]':>8} {'limit':>6} {'exit':>5} {'driven':>7} {'kept':>7}"
    "  files, last line"
)


class Driven:
    """A command that drives the bench of processes; `out` is where it writes."""

    def __init__(self, bench, verb, out):
        self.bench, self.out = bench, out
        self.socket = load_bench(bench.path).socket_path
        (bench.folder / "long.yaml").write_text(yaml.safe_dump(SEQUENCE), encoding="utf-8")
        places = {"bench": bench.path, "folder": bench.folder, "out": out}
        command = [sys.executable, "-m", "piezod", *(word.format(**places) for word in VERBS[verb])]
        self.log = bench.folder / "said"
        with self.log.open("w") as file:
            self.process = Popen(command, stdout=file, stderr=file, cwd=bench.folder)
        self.first_tick = 0
        self.is_service = verb == "run"

    def begin(self):
        if self.is_service:
            self.await_status("DISARMED")
            while not self.status().get("connected"):
                time.sleep(0.02)
            self.ask("arm")
        self.first_tick = self.await_status("RUNNING")["ticks"]

    def ask(self, command):
        return command_and_wait(self.socket, command, wait=False)

    def status(self):
        with contextlib.suppress(PiezodError):
            return self.ask("status")
        return {}

    def await_status(self, state, ticks=0):
        deadline_s = time.monotonic() + WITHIN_S
        while (now := self.status()).get("state") != state or now["ticks"] < ticks:
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                raise AssertionError(f"no {state}: {now}, {self.said()}")
            time.sleep(0.02)
        return now

    def control_pid(self):
        found = subprocess.run(
            ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(self.process.pid)],
            capture_output=True, text=True, check=False,
        ).stdout.splitlines()  # fmt: skip
        return next(int(line.split()[0]) for line in found if "spawn_main" in line)

    def said(self):
        return self.log.read_text(encoding="utf-8").strip()

    def close(self):
        if self.process.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.terminate()
                self.process.wait(timeout=WITHIN_S)
        self.process.kill()
        self.process.wait()


def _signal(number):
    return lambda drive: os.kill(drive.process.pid, number)


def _control(number):
    return lambda drive: os.kill(drive.control_pid(), number)


def _command(name):
    def act(drive):
        client = Client(drive.socket)
        client.ask(name)
        client.close()

    return act


WATCHDOG_MS = TIMING["device_watchdog_ms"]
LOSS_MS = TIMING["comm_loss_ms"]
# event: (what is done, ramp, time before it begins [ms]); no ramp: the output goes on
EVENTS = {
    "status": (_command("status"), None, 0.0),
    "stop": (_command("stop"), "fast", 0.0),
    "disarm": (_command("disarm"), "slow", 0.0),
    "SIGINT": (_signal(signal.SIGINT), "slow", 0.0),
    "SIGTERM": (_signal(signal.SIGTERM), "slow", 0.0),
    "SIGKILL": (_signal(signal.SIGKILL), "slow", 0.0),
    "SIGKILL control": (_control(signal.SIGKILL), "slow", WATCHDOG_MS),
    "SIGSTOP control": (_control(signal.SIGSTOP), "slow", WATCHDOG_MS),
    "device silent": (lambda drive: drive.bench.device.ask("wire", what="silent"), "slow", WATCHDOG_MS),
    "force trip": (lambda drive: drive.bench.device.ask("reading_fault", kind="stuck", value=400.0), "fast", 50.0),
    "heat trip": (lambda drive: drive.bench.device.ask("reading_fault", kind="hot", value=90.0), "slow", 500.0),
    "disk full": (lambda drive: fill(drive.out), None, 0.0),
}


def observe(bench, verb, event, out):
    """Drive, let the event happen once, and look at the device and the disk."""
    drive = Driven(bench, verb, out)
    try:
        drive.begin()
        ticks = drive.await_status("RUNNING", drive.first_tick + DRIVEN_TICKS)["ticks"] - drive.first_tick
        act, ramp, before_ms = EVENTS[event]
        bench.device.ask("mark")
        voltage_V, begun_ns = bench.device.ask("report")["output_V"], time.monotonic_ns()
        act(drive)
        limit_ms = None
        if ramp is not None:
            limit_ms = before_ms + 1e3 * bench.device.ask("report")["highest_V"] / RAMPS_V_PER_S[ramp] + MARGIN_MS
        rest_ms = _rest_ms(bench, begun_ns, limit_ms)
        if event == "SIGSTOP control":
            os.kill(drive.control_pid(), signal.SIGCONT)
        code = _end(drive, verb, goes_on=ramp is None)
    finally:
        drive.close()
    driven_s, deadline_s = ticks / RATE_HZ, time.monotonic() + KEPT_WITHIN_S
    while (kept := _kept(out, bench.folder))[0] < driven_s - LOST_S and time.monotonic() < deadline_s:
        time.sleep(0.2)
    kept_s, files = kept
    for left in bench.folder.glob("*-unfinished-*"):
        shutil.rmtree(left)
    return Found(verb, event, voltage_V, rest_ms, limit_ms, code, driven_s, kept_s, files, _last(drive.said()))


def _rest_ms(bench, begun_ns, limit_ms):
    deadline_s = time.monotonic() + (1.0 if limit_ms is None else 5.0 + limit_ms / 1e3)
    while time.monotonic() < deadline_s:
        report = bench.device.ask("report")
        if report["rest_ns"] and report["rest_ns"] > begun_ns:
            return (report["rest_ns"] - begun_ns) / 1e6
        time.sleep(0.02)
    return float("inf")


def _end(drive, verb, *, goes_on):
    """Exit code of a command that ends by itself; None where it goes on, as a daemon does after all but a signal."""
    if goes_on or verb == "run":
        with contextlib.suppress(subprocess.TimeoutExpired):
            return drive.process.wait(timeout=1.0)
        return None
    return drive.process.wait(timeout=WITHIN_S)


def _kept(out, folder):
    """Driven time in the files of the command [s], and their names; rows of a killed command stay beside the bench."""
    files = [path for path in sorted(out.rglob("*")) if path.is_file() and path.name != "ballast"]
    files += sorted(folder.glob("*-unfinished-*/*"))
    lengths = [0.0]
    for path in files:
        with contextlib.suppress(PiezodError):
            recording = read_recording(path)
            lengths.append(recording.time_s[-1] - recording.time_s[0] + 1 / RATE_HZ)
    return max(lengths), [path.name for path in files]


def _last(text):
    return text.splitlines()[-1] if text else ""


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    live = LiveBench(tmp_path_factory.mktemp("verbs"), changes=PATIENT)
    live.content = yaml.safe_load(live.path.read_text(encoding="utf-8"))
    print("\n" + HEADER)
    yield live
    live.close()


@pytest.fixture(autouse=True)
def restored(bench):
    yield
    bench.device.ask("reading_fault")
    bench.device.ask("wire", what="restore")


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("verb", VERBS)
def test_a_command_that_drives_brings_the_output_to_rest_in_time_and_keeps_its_rows(bench, tmp_path, verb, event):
    with raised_priority(), small_folder(tmp_path / "out", 64.0) as out:
        recorder = {"folder": str(out / "recorder")} if verb == "run" else None
        bench.path.write_text(yaml.safe_dump(bench.content | {"recorder": recorder}), encoding="utf-8")
        (bench.folder / "ring.heat").unlink(missing_ok=True)
        found = observe(bench, verb, event, out)
    print(found.line(), flush=True)
    if found.limit_ms is not None:
        assert found.rest_ms <= found.limit_ms
    if event != "disk full" and verb != "proof":  # its record holds steps, no rows
        assert found.kept_s >= found.driven_s - LOST_S
