"""Ticks missed by a driving bench while the daily check diagnoses its newest drive, beside the bench alone.

python -m tests.studies daily_check [--runs 3] [--rate 1000]

The check runs as its unit starts it: nice 19, idle scheduling, idle I/O. Runs with and without it alternate, so
that both have the load of the machine.
"""

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import yaml

from piezod.errors import PiezodError
from piezod.recording.ring_log import RingReader
from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.service import bench_file
from tests.benchmarks.table import NotMeasuredError
from tests.studies.soak import Soaked, _arm, _connected, _ended, _follow, _percentile_us, _service

DRIVEN_S = 25.0  # before the check: its shortest drive is 20 s
BEHIND = ["nice", "-n", "19", "chrt", "--idle", "0", "ionice", "-c", "3"]


@dataclass(frozen=True)
class Run:
    """Figures of one run; the check's exit code is None without one, or while it still runs at the end."""

    soaked: Soaked
    check_s: float
    exit_code: int | None


def run_bench(seconds: float, rate_Hz: float, *, checked: bool) -> Run:
    """Drive a bench with its recorder for some seconds, with the check or alone."""
    soaked = Soaked(rate_Hz)
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="piezod-check-")))
        with peers.device_priority():
            address = stack.enter_context(peers.emulator("tcp", "real"))
        bench = bench_file(folder, address, rate_Hz)
        content = yaml.safe_load(bench.read_text(encoding="utf-8"))
        content["recorder"] = {"folder": str(folder / "recordings")}
        bench.write_text(yaml.safe_dump(content), encoding="utf-8")
        service = stack.enter_context(_ended(_service(bench)))
        _arm(_connected(bench, service, stack))
        time.sleep(DRIVEN_S)
        client = _connected(bench, service, stack)
        command = [*BEHIND, sys.executable, "-m", "piezod", "diagnose", "--from-archive", str(bench)]
        command += ["-o", str(folder / "recordings" / "checks"), "--within", "30"]
        ended: list[float] = []
        process = None
        if checked:
            process = stack.enter_context(_ended(subprocess.Popen(command, stdin=subprocess.DEVNULL)))

        def look(soaked: Soaked) -> None:
            if process is not None and not ended and process.poll() is not None:
                ended.append(soaked.seconds)

        _follow(soaked, client, RingReader(bench.parent / "ring"), seconds, look)
        return Run(soaked, ended[0] if ended else seconds, None if process is None else process.poll())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("--seconds", type=float, default=60.0, metavar="S", help="duration of each run, %(default)g")
    parser.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="rate of the loop, %(default)g")
    parser.add_argument("--runs", type=int, default=3, help="runs of each kind, %(default)d")
    parser.set_defaults(run=run)


def run(options: argparse.Namespace, parser: argparse.ArgumentParser) -> None:
    """Print a line for each run, then the ranges."""
    missed: dict[bool, list[float]] = {False: [], True: []}
    print(f"{'run':10} {'ticks':>8} {'missed':>7} {'missed %':>9} {'late 99 % [us]':>15} {'99.9 %':>8} {'check':>20}")
    try:
        for _ in range(options.runs):
            for checked in (False, True):
                found = run_bench(options.seconds, options.rate, checked=checked)
                soaked = found.soaked
                share = 100.0 * soaked.missed / max(soaked.ticks + soaked.missed, 1)
                missed[checked].append(share)
                late = [f"{_percentile_us(soaked.lateness, q):.0f}" for q in (99.0, 99.9)]
                ended = f"exit {found.exit_code} after {found.check_s:.0f} s" if checked else ""
                print(
                    f"{'with check' if checked else 'alone':10} {soaked.ticks:8} {soaked.missed:7} {share:9.3f} "
                    f"{late[0]:>15} {late[1]:>8} {ended:>20}",
                    flush=True,
                )
    except (NotMeasuredError, PiezodError) as error:
        parser.error(str(error))
    for checked, shares in missed.items():
        print(f"{'with check' if checked else 'alone'}: {min(shares):.3f} to {max(shares):.3f} % of the ticks missed")
