"""The emulated bench as a process of its own, started by a command and ended with it."""

import contextlib
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import yaml

from piezod.commissioning.shipped_files import shipped
from piezod.errors import UnreachableError

VIRTUAL_RATE_HZ = 200  # enough for what is recorded at 0.1 Hz, and quick
STANDSTILL_MS = 500  # a machine may stand still for a tenth of a second; that is no lost device


@contextlib.contextmanager
def emulated_bench(config: Path, *arguments: str) -> Iterator[dict[str, str]]:
    """Start `python -m firmware_sim`, yield what it serves (`tcp`, `rtu`, `line`), end it.

    Raises
    ------
    UnreachableError
        It did not come up.
    """
    command = [sys.executable, "-m", "firmware_sim", str(config), "--until-stdin-closes", *arguments]
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
def emulated_bench_file(folder: Path, scenario: str, effects: Sequence[str] = ()) -> Iterator[Path]:
    """Start an emulated bench in virtual time and yield a bench file that points at it.

    Parameters
    ----------
    folder
        Where the file is written.
    scenario
        Of the emulator: `stack`, `seed_bench` or a YAML file.
    effects
        Switched on at their default strengths.

    Raises
    ------
    UnreachableError
        It did not come up.
    """
    content = yaml.safe_load(shipped("bench.yaml").read_text(encoding="utf-8"))
    switched = [part for name in effects for part in ("--effect", name)]
    arguments = ("--port", "0", "--time", "virtual", "--scenario", scenario, *switched)
    with emulated_bench(shipped("emulator.yaml"), *arguments) as serves:
        host, _, port = serves["tcp"].rpartition(":")
        content["rate_Hz"] = VIRTUAL_RATE_HZ
        content["link"] |= {"host": host, "port": int(port), "timeout_s": 1e-3 * STANDSTILL_MS}
        content["limits"] |= {
            "stale_after_ms": 4000 / VIRTUAL_RATE_HZ,
            "comm_loss_ms": 4 * STANDSTILL_MS,
            "device_watchdog_ms": 2 * STANDSTILL_MS,
        }
        content["daemon"]["ring_log"] = f"/dev/shm/piezod-emulated-{port}.ring"  # noqa: S108  # meant to be seen
        path = folder / "bench.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        yield path
