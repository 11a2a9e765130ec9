"""The emulated bench as a child process, and bench configurations that are connected to it."""

import contextlib
import json
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import yaml

from piezod.commissioning.shipped_files import shipped
from piezod.config import BenchConfig, load_bench
from piezod.errors import UnreachableError
from piezod.runtime.interpreter import python

VIRTUAL_RATE_HZ = 200  # tick rate in virtual time [Hz]: high enough for recordings at 0.1 Hz, and fast to emulate
STANDSTILL_MS = 500
"""Standstill of this machine that must not count as a lost device [ms]; virtual machines pause for 100 ms."""


@contextlib.contextmanager
def emulator_process(config: Path, *arguments: str) -> Iterator[dict[str, str]]:
    """Start `python -m firmware_sim`, yield the addresses that it serves, and end it.

    Yields
    ------
    dict
        Addresses by protocol: `tcp`, `rtu`, `line`.

    Raises
    ------
    UnreachableError
        The emulator did not start.
    """
    command = python("-m", "firmware_sim", str(config), "--until-stdin-closes", *arguments)
    process = subprocess.Popen(  # noqa: S603  # our own interpreter and module
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        line = process.stdout.readline() if process.stdout else ""
        if not line:
            raise UnreachableError(f"the emulated bench did not start: {' '.join(command)} ended with {process.wait()}")
        yield json.loads(line)
    finally:
        process.terminate()
        try:
            process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        for stream in (process.stdin, process.stdout):
            if stream:
                stream.close()


@contextlib.contextmanager
def real_time_bench() -> Iterator[tuple[BenchConfig, Path]]:
    """Start an emulated bench in real time and yield the shipped configuration, connected to it.

    Yields
    ------
    tuple
        Bench configuration, and the file that it was read from.

    Raises
    ------
    UnreachableError
        The emulator did not start.
    """
    path = shipped("bench.yaml")
    bench = load_bench(path)
    with emulator_process(shipped("emulator.yaml"), "--port", "0") as addresses:
        host, _, port = addresses["tcp"].rpartition(":")
        timeout_s = 1e-3 * STANDSTILL_MS
        link = bench.link.model_copy(update={"host": host, "port": int(port), "timeout_s": timeout_s})
        tolerant = {
            "comm_loss_ms": 2.0 * STANDSTILL_MS,
            "device_watchdog_ms": STANDSTILL_MS,
            "missed_ticks_in_a_row": round(timeout_s * bench.rate_Hz),
        }
        limits = bench.limits.model_copy(update=tolerant)
        ring_log = f"/dev/shm/piezod-demo-{port}.ring"  # noqa: S108  # shared memory, meant to be read by others
        daemon = bench.daemon.model_copy(update={"ring_log": ring_log})
        yield bench.model_copy(update={"link": link, "limits": limits, "daemon": daemon}), path


@contextlib.contextmanager
def virtual_time_bench(folder: Path, scenario: str, effects: Sequence[str] = ()) -> Iterator[Path]:
    """Start an emulated bench in virtual time and yield a bench configuration file that is connected to it.

    Parameters
    ----------
    scenario
        Scenario of the emulator: `stack`, `seed_bench` or a YAML file.
    effects
        Effects to switch on, with their default strengths.

    Yields
    ------
    pathlib.Path
        Bench configuration file.

    Raises
    ------
    UnreachableError
        The emulator did not start.
    """
    content = yaml.safe_load(shipped("bench.yaml").read_text(encoding="utf-8"))
    effect_options = [part for name in effects for part in ("--effect", name)]
    arguments = ("--port", "0", "--time", "virtual", "--scenario", scenario, *effect_options)
    with emulator_process(shipped("emulator.yaml"), *arguments) as addresses:
        host, _, port = addresses["tcp"].rpartition(":")
        content["rate_Hz"] = VIRTUAL_RATE_HZ
        content["link"] |= {"host": host, "port": int(port), "timeout_s": 1e-3 * STANDSTILL_MS}
        content["limits"] |= {
            "stale_after_ms": 4000 / VIRTUAL_RATE_HZ,
            "comm_loss_ms": 4 * STANDSTILL_MS,
            "device_watchdog_ms": 2 * STANDSTILL_MS,
        }
        content["daemon"]["ring_log"] = f"/dev/shm/piezod-emulated-{port}.ring"  # noqa: S108  # shared memory
        path = folder / "bench.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        yield path
