"""What `piezod/runtime/` costs: exchange and tick with the door, and with the names of the standard library instead.

Both programs run in turn, each in a process of its own. The second has its sources changed while they are loaded:
`clock.monotonic()` reads `time.monotonic()` there. Processor time counts, so other work on the machine does not.
"""

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path

import numpy as np

from tests.benchmarks import modbus_peers as peers
from tests.benchmarks.table import Row

ROOMS = ("piezod.control", "piezod.transport", "piezod.recording.ring_log")
NAMES = (
    (r"(?<![\w.])clock\.boot_ns\(\)", "time.clock_gettime_ns(time.CLOCK_BOOTTIME)"),
    (r"(?<![\w.])clock\.(monotonic_ns|monotonic|perf_counter_ns|process_time|sleep)\b", r"time.\1"),
    (r"(?<![\w.])clock\.wall_ns\b", "time.time_ns"),
    (r"(?<![\w.])sockets\.(poll|select)\b", r"select.\1"),
    (r"(?<![\w.])sockets\.(socket|getaddrinfo)\b", r"socket.\1"),
    (r"(?<![\w.])descriptors\.(read|readv|write|close)\b", r"os.\1"),
)
EXCHANGES, TICKS, ROUNDS = 40_000, 15_000, 11
RATIO = (0.98, 1.02)
QUICK = 10


class WithoutDoor(SourceFileLoader):
    """Loads a module with the names of the standard library in place of the door."""

    def get_code(self, fullname):
        path = self.get_filename(fullname)
        text = Path(path).read_text(encoding="utf-8")
        for pattern, name in NAMES:
            text = re.sub(pattern, name, text)
        head = re.search(r"^(?=from |import )", text, re.MULTILINE)
        if head is not None:
            text = f"{text[: head.start()]}import os, select, socket, time\n{text[head.start() :]}"
        return compile(text, path, "exec")


class Finder(MetaPathFinder):
    """Finds the modules of the rooms."""

    def find_spec(self, fullname, path, target=None):
        if not fullname.startswith(ROOMS):
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        assert spec is not None
        return spec_from_file_location(
            fullname, spec.origin, loader=WithoutDoor(fullname, str(spec.origin)),
            submodule_search_locations=spec.submodule_search_locations,
        )  # fmt: skip


def exchange_ns(where: str, count: int) -> float:
    """Processor time of one exchange over TCP with the minimal server [ns]."""
    from piezod.transport import make_link
    from tests.benchmarks.exchange import link_config

    link = make_link(link_config(peers.Address("tcp", where)))
    link.open()
    for _ in range(count // 10):
        link.exchange(0.0)
    begun_ns = time.process_time_ns()
    for _ in range(count):
        link.exchange(0.0)
    took_ns = time.process_time_ns() - begun_ns
    link.close()
    return took_ns / count


def tick_ns(count: int) -> float:
    """Processor time of one tick of the loop, with ring log and emulated device [ns]."""
    from tests.faults.manual_clock_bench import ManualClockBench

    bench = ManualClockBench()
    bench.arm()
    bench.run(count // 10)
    begun_ns = time.process_time_ns()
    for _ in range(count):
        bench.loop.run_tick()
        bench.loop.wait()
    took_ns = time.process_time_ns() - begun_ns
    bench.close()
    return took_ns / count


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows of both, as medians of rounds in turn."""
    part = QUICK if quick else 1
    with peers.minimal_server("tcp") as address:
        for what, count in (("exchange", EXCHANGES // part), ("tick", TICKS // part)):
            pairs = np.array([[_child(how, what, address.where, count) for how in _turn(k)][:: 1 - 2 * (k % 2)]
                              for k in range(ROUNDS)])  # fmt: skip
            with_door, without = np.median(pairs, axis=0)
            ratios = pairs[:, 0] / pairs[:, 1]
            note = f"paired ratios: median {np.median(ratios):.3f}, {ratios.min():.3f} to {ratios.max():.3f}"
            yield Row("door", f"{what}, processor time", "us", with_door * 1e-3, without * 1e-3,
                      "names of the standard library", most_ratio=RATIO[1], note=note)  # fmt: skip


def _turn(number: int) -> tuple[str, str]:
    return ("with", "without") if number % 2 == 0 else ("without", "with")


def _child(how: str, what: str, where: str, count: int) -> float:
    command = [sys.executable, "-m", "tests.benchmarks.door", how, what, where, str(count)]
    return float(json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout))


if __name__ == "__main__":
    if sys.argv[1] == "without":
        sys.meta_path.insert(0, Finder())
    number = int(sys.argv[4])
    print(exchange_ns(sys.argv[3], number) if sys.argv[2] == "exchange" else tick_ns(number))
