"""Every effect of the catalogue on the emulated bench, recorded over its link and diagnosed.

The model is identified on a bench without any effect, recorded in the same way. Both recordings therefore contain the
influence of the link, such as the tick between a command and its reading. Every step is a `piezod` command.

Interlocks that would end such a recording are off: read-back (clamped amplifier), stuck sensor, force rate (jumping
force) and sign check (lost contact).
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from piezod.excitation import IDENTIFICATION
from piezod.recording import Recording, read_csv, write_csv
from tests.studies.mixed_work import mixed_work
from tests.studies.strengths import NOISE_N, SWITCHED, Switched
from tests.studies.table import Row

ROOT = Path(__file__).parents[2]
PATIENT_s = 0.5  # longer than a standstill of a virtual machine
WORK_SEED, BASE_NOISE, WORK_NOISE = 3, 1, 2
WITHIN_s = 1800.0
LIMITS = {
    "stale_after_ms": 20,
    "comm_loss_ms": 20_000,
    "device_watchdog_ms": 10_000,
    "missed_ticks_in_a_row": 5000,
    "dissipation_max_W": None,
    "loss_tangent": None,
    "force_min_N": -400.0,
    "force_trip_N": 900.0,
    "force_rate_trip_N_per_s": None,
    "readback_trip_V": None,
    "stuck_samples": None,
}


@dataclass(frozen=True)
class Size:
    """Size of the recordings.

    Parameters
    ----------
    rate_Hz
        Rate of the loop [Hz].
    work_s
        Duration of the mixed work [s].
    identification_Hz
        Frequency of the main triangle of the excitation that the model comes from.
    orders
        Plays and dead zones; None: chosen on held-out data.
    """

    rate_Hz: float
    work_s: float
    identification_Hz: float
    orders: tuple[int, int] | None


LONG = Size(500.0, 60.0, 0.25, None)
SHORT = Size(250.0, 30.0, 0.5, (14, 6))
PEAK_V = 130.0  # peak of the work, within the range of the identification


class StepError(Exception):
    """A command of the chain failed; the message holds its last lines."""


def study(names: Sequence[str], size: Size, folder: Path, *, jobs: int) -> Iterator[Row]:
    """Yield the rows in the order of the names."""
    model = identified(folder, size)
    work = folder / "drive.csv"
    voltage_V = mixed_work(WORK_SEED, size.work_s, size.rate_Hz, PEAK_V)
    write_csv(Recording(np.arange(voltage_V.size) / size.rate_Hz, {"voltage_V": voltage_V}), work)
    with ThreadPoolExecutor(jobs) as pool:
        threads = {"OMP_NUM_THREADS": "1"} if jobs > 1 else {}
        yield from pool.map(lambda name: scenario_row(name, SWITCHED[name], model, work, size, folder, threads), names)


def identified(folder: Path, size: Size) -> Path:
    """The model of a bench without any effect."""
    model = folder / "model.yaml"
    if not model.exists():
        recorded(folder / "base", Switched(None), BASE_NOISE, size, IDENTIFICATION, folder / "identification.csv")
        orders = () if size.orders is None else ("--plays", size.orders[0], "--dead-zones", size.orders[1])
        run("identify", folder / "identification.csv", "-o", model, *orders)
    return model


def scenario_row(
    name: str, switched: Switched, model: Path, work: Path, size: Size, folder: Path, threads: dict[str, str]
) -> Row:
    """Record with the effect, diagnose, and compare with the truth."""
    place = folder / name
    try:
        record = recorded if switched.over_link else logged
        record(place, switched, WORK_NOISE, size, work, place / "work.csv")
        begun_s = time.monotonic()
        run("diagnose", place / "work.csv", "--model", model, "-o", place / "out", threads=threads)
        seconds = time.monotonic() - begun_s
    except StepError as error:
        return Row(name, why=str(error))
    findings = json.loads((place / "out" / "findings.json").read_text(encoding="utf-8"))
    return row(name, switched, findings, noises(switched, place / "work.csv", size), seconds)


def row(name: str, switched: Switched, findings: dict, size: float | None, seconds: float) -> Row:
    """The row that compares the findings with the truth."""
    named = tuple(one["name"] for one in findings["effects"])
    mine = next((one for one in findings["effects"] if one["name"] == switched.effect), None)
    found = None if mine is None or not switched.parameter else mine["parameters"][switched.parameter]["value"]
    truth = {switched.effect} if switched.effect else set()
    fit = findings["fit"]["held_out"]
    return Row(
        name,
        size,
        named,
        set(named) == truth and (bool(truth) or findings["verdict"] == "matches"),
        switched.parameter,
        switched.truth,
        found,
        switched.alike,
        findings["verdict"],
        fit["before"],
        fit["after"],
        findings["noise_floor"]["value"],
        seconds,
        tuple(rival["name"] for one in findings["effects"] for rival in one["rivals"]),
    )


def noises(switched: Switched, work: Path, size: Size) -> float | None:
    """Rms change by the effect without its mean, over the noise; from two benches without a link."""
    if switched.effect is None:
        return None
    voltage_V = read_csv(work).channel("voltage_V")
    with_it, without = (without_link(one, WORK_NOISE, voltage_V, size) for one in (switched, Switched(None)))
    return float(np.std(with_it - without)) / NOISE_N


def without_link(switched: Switched, seed: int, voltage_V: np.ndarray, size: Size) -> np.ndarray:
    """Readings of the bench immediately before each command acts [N]."""
    effects = {} if switched.effect is None else {switched.effect: switched.values}
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": NOISE_N}, "effects": effects})
    return Bench(scenario, seed=seed).run(voltage_V, 1.0 / size.rate_Hz)


def logged(folder: Path, switched: Switched, seed: int, size: Size, drive: Path, output: Path) -> None:
    """Record without a link; a row is a command and the reading at the end of its tick."""
    folder.mkdir(parents=True, exist_ok=True)
    most_V = yaml.safe_load((ROOT / "config" / "bench.yaml").read_text(encoding="utf-8"))["limits"]["slew_V_per_s"]
    voltage_V = read_csv(drive).channel("voltage_V")
    step_V = most_V / size.rate_Hz
    for k in range(1, voltage_V.size):
        voltage_V[k] = np.clip(voltage_V[k], voltage_V[k - 1] - step_V, voltage_V[k - 1] + step_V)
    force_N = without_link(switched, seed, voltage_V, size)
    rows = {"voltage_V": voltage_V[:-1], "force_N": force_N[1:]}
    write_csv(Recording(np.arange(force_N.size - 1) / size.rate_Hz, rows), output)


def recorded(folder: Path, switched: Switched, seed: int, size: Size, excitation: object, output: Path) -> None:
    """Start the emulated bench with one effect and record over its link."""
    effects = {} if switched.effect is None else {switched.effect: switched.values}
    recorded_with(folder, effects, seed, size, excitation, output)


def recorded_with(
    folder: Path, effects: dict[str, dict[str, object]], seed: int, size: Size, excitation: object, output: Path
) -> None:
    """Start the emulated bench with several effects and record over its link."""
    folder.mkdir(parents=True, exist_ok=True)
    emulator = yaml.safe_load((ROOT / "config" / "emulator.yaml").read_text(encoding="utf-8"))
    emulator |= {"seed": seed, "time": "virtual", "physics": {"load_cell": {"white_noise_N": NOISE_N}}}
    emulator["tcp"]["port"] = 0
    emulator["effects"] = effects
    (folder / "emulator.yaml").write_text(yaml.safe_dump(emulator), encoding="utf-8")
    with serving(folder / "emulator.yaml") as (host, port):
        bench = yaml.safe_load((ROOT / "config" / "bench.yaml").read_text(encoding="utf-8"))
        bench |= {"rate_Hz": size.rate_Hz, "model": "none.yaml"}
        bench["link"] |= {"host": host, "port": port, "timeout_s": PATIENT_s}
        bench["limits"] |= LIMITS
        bench["arming"]["without"] = ["sign_check"]
        bench["real_time"] = {"fifo_priority": 0, "lock_memory": False, "hold_cpu_latency": False}
        bench["daemon"] = {"ring_log": str(folder / "ring"), "ring_seconds": 60}
        (folder / "bench.yaml").write_text(yaml.safe_dump(bench), encoding="utf-8")
        run(
            "record", folder / "bench.yaml", "--excitation", excitation, "--frequency", size.identification_Hz,
            "-o", output,
        )  # fmt: skip


@contextlib.contextmanager
def serving(config: Path) -> Iterator[tuple[str, int]]:
    """Run the emulated bench as a process; yields host and port."""
    process = subprocess.Popen(
        [sys.executable, "-m", "firmware_sim", str(config), "--until-stdin-closes"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    try:
        line = process.stdout.readline()
        if not line:
            raise StepError(f"the emulator ended with {process.wait()}")
        host, _, port = json.loads(line)["tcp"].rpartition(":")
        yield host, int(port)
    finally:
        process.stdin.close()
        process.wait(timeout=30)
        process.stdout.close()


def run(*arguments: object, threads: dict[str, str] | None = None) -> None:
    """Run a `piezod` command.

    Raises
    ------
    StepError
        The command failed; the message holds its last lines.
    """
    done = subprocess.run(
        [sys.executable, "-m", "piezod", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=WITHIN_s,
        check=False,
        cwd=ROOT,
        env=os.environ | (threads or {}),
    )
    if done.returncode != 0:
        messages = done.stderr.strip().splitlines() or ["no message"]
        raise StepError(f"piezod {arguments[0]} ended with {done.returncode}: {' | '.join(messages[-3:])}")
