"""Command line: inject the listed faults, kills or false replies, and print the table."""

import argparse
import faulthandler
import json
import sys
import time
from pathlib import Path

from tests.faults import interlocks, kills, replies, run
from tests.faults.bench_pool import open_bench_pool, raised_priority
from tests.faults.probe import Probe


def main() -> int:
    """Run the chosen study; returns 1 when a fault was not survived."""
    faulthandler.enable()
    parser = argparse.ArgumentParser(prog="python -m tests.faults", description=__doc__)
    parser.add_argument("--mutate", nargs="*", metavar="NAME", help="take each interlock out: its rows must fail")
    studies = parser.add_subparsers(dest="what")
    listed = studies.add_parser("list", help="every fault of faults.yaml")
    listed.add_argument("ids", nargs="*", metavar="ID", help="ids such as T3 V6; default: all")
    listed.add_argument("--json", type=Path, metavar="FILE", help="also write the results as JSON")
    killed = studies.add_parser("kills", help="repeated SIGKILL and SIGSTOP of the control process")
    killed.add_argument("--times", type=int, default=100)
    replied = studies.add_parser("replies", help="stale and false replies to the links and to plain pymodbus clients")
    replied.add_argument("--times", type=int, default=1000, help="number of replies of each kind")
    options = parser.parse_args()
    if options.mutate is None and options.what is None:
        parser.error("name a study, or --mutate")
    begun_s = time.monotonic()
    code = {None: _mutate, "list": _list, "kills": _kills, "replies": _replies}[options.what](options)
    print(f"in {time.monotonic() - begun_s:.0f} s")
    return code


def _list(options) -> int:
    faults = run.faults()
    if unknown := sorted(set(options.ids) - {fault.id for fault in faults}):
        print(f"no fault is called {', '.join(unknown)}", file=sys.stderr)
        return 2
    print(run.header(), flush=True)
    probe, results = Probe(), []
    try:
        with open_bench_pool() as pool:
            for fault in faults:
                if not options.ids or fault.id in options.ids:
                    results.append(run.run(fault, pool, probe))
                    print(results[-1].text(), flush=True)
    finally:
        probe.close()
    print(run.summary(results))
    if options.json:
        rows = [
            {"id": one.fault.id, "survived": one.survived, "skipped": one.skipped, "problems": one.problems,
             "after_ms": one.observed and one.observed.after_ms, "figures": one.observed and one.observed.figures,
             "tries": one.tries, "lasted_s": one.lasted_s}
            for one in results
        ]  # fmt: skip
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return 1 if any(result.problems for result in results) else 0


def _mutate(options) -> int:
    return interlocks.mutate(options.mutate)


def _kills(options) -> int:
    print(kills.HEADER, flush=True)
    found = [kills.kills(how, options.times, _progress) for how in ("SIGKILL", "SIGSTOP")]
    for one in found:
        print(kills.line(one))
    problems = [f"{one.how}: {text}" for one in found for text in one.problems()]
    print("\n".join(problems) or "the device was safe every time")
    return 1 if problems else 0


def _progress(found) -> None:
    if sys.stderr.isatty():
        print(f"\r{found.how} {found.times} ", end="", file=sys.stderr, flush=True)


def _replies(options) -> int:
    print(replies.HEADER, flush=True)
    with raised_priority():
        rows = list(replies.rows(options.times, show=lambda row: print(row.text(), flush=True)))
    print(replies.summary(rows))
    return 1 if any(row.accepted for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
