"""Command line: run the named benchmarks, or all, and print the table."""

import argparse
import json
import platform
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from piezod.errors import PiezodError
from tests.benchmarks.table import NotMeasuredError, Row, header

BENCHMARKS = (
    "chain",
    "extended",
    "batch",
    "wakeup",
    "exchange",
    "whole_tick",
    "service",
    "memory",
    "identification",
    "commands",
)
SLOW = ("companions", "diagnose", "door")  # minutes, and up to an hour: only when named


def run(name: str, *, quick: bool) -> Iterator[Row]:
    """Rows of one benchmark; a single row with the reason when it cannot be measured."""
    try:
        yield from import_module(f"tests.benchmarks.{name}").measure(quick=quick)
    except (NotMeasuredError, PiezodError) as reason:
        yield Row(name, f"not measured: {reason}")


def main() -> None:
    """Run the benchmarks, print the table and write the JSON file."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help=f"one of {', '.join(BENCHMARKS)} (default: all), {', '.join(SLOW)}",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows as JSON")
    parser.add_argument("--quick", action="store_true", help="fewer and shorter rounds: under 20 s in all")
    options = parser.parse_args()
    if unknown := sorted(set(options.names) - {*BENCHMARKS, *SLOW}):
        parser.error(f"no benchmark is called {', '.join(unknown)}; there are {', '.join((*BENCHMARKS, *SLOW))}")
    begun = time.monotonic()
    print(header(), flush=True)
    rows = []
    for name in options.names or BENCHMARKS:
        for row in run(name, quick=options.quick):
            print(row.text(), flush=True)
            rows.append(row)
    print(f"{time.monotonic() - begun:.0f} s, Python {platform.python_version()}, {platform.platform()}")
    if options.json:
        options.json.write_text(json.dumps([row.as_dict() for row in rows], indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
