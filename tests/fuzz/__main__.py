"""Command line: fuzz every parser and print the table."""

import argparse
import importlib.util
import os
import sys
import tempfile
import time
from pathlib import Path

from tests.fuzz import files, frames, messages
from tests.fuzz.target import Target
from tests.fuzz.watch import Result, Watch, reproduce

MODULES = (frames, files, messages)
GROUPS = {"frames": 20_000, "configurations": 1000, "models": 1000, "recordings": 3000, "messages": 5000}
"""Groups of targets and their default numbers of cases: one to two minutes in total."""

_COLUMNS = (
    "{group:<15} {target:<15} {engine:<9} {cases:>9} {accepted:>9} {failed:>7} {crashes:>8} {hangs:>6} {peak:>9} "
    "{grown:>9} {fds:>4} {rate:>8}"
)


def main() -> int:
    """Run the fuzzer; returns 1 when an input fails."""
    options = _parse()
    targets = {target.name: (module.__name__, target) for module in MODULES for target in module.TARGETS}
    if options.reproduce:
        name, path = options.reproduce
        what = reproduce(targets[name][1], Path(path))
        print(what or f"{name}: no violation")
        return 1 if what else 0
    engine = _engine(options.engine)
    print(_COLUMNS.format(**_HEADER), flush=True)
    results, begun_s = [], time.monotonic()
    for group in GROUPS:
        chosen = [(module, target) for module, target in targets.values() if target.group == group]
        for number, (module, target) in enumerate(chosen):
            count = (getattr(options, group) + number) // len(chosen)
            if count:
                watch = Watch(module, target.name, engine, options.keep)
                results.append(watch.run(options.seed, count, _progress(target, count)))
                print(_row(group, results[-1]), flush=True)
    findings = [finding for result in results for finding in result.findings]
    print(_sum(results), f"seed {options.seed}, {time.monotonic() - begun_s:.0f} s,", _load())
    for finding in findings:
        print(finding.text())
    return 1 if findings else 0


_HEADER = {
    "group": "group",
    "target": "target",
    "engine": "engine",
    "cases": "cases",
    "accepted": "accepted",
    "failed": "failed",
    "crashes": "crashes",
    "hangs": "hangs",
    "peak": "peak MiB",
    "grown": "grown by",
    "fds": "fds",
    "rate": "1/s",
}


def _row(group: str, result: Result) -> str:
    return _COLUMNS.format(
        group=group,
        target=result.target,
        engine=result.engine,
        cases=result.cases,
        accepted=result.accepted,
        failed=len(result.findings),
        crashes=result.crashes,
        hangs=result.hangs,
        peak=f"{result.peak_MiB:.0f}",
        grown=f"{result.grown_MiB:.0f}",
        fds=f"{result.descriptors:+d}",
        rate=f"{result.cases / max(result.took_s, 1e-9):.0f}",
    )


def _sum(results: list[Result]) -> str:
    names = ("cases", "crashes", "hangs")
    sums = {name: sum(getattr(result, name) for result in results) for name in names}
    failed = sum(len(result.findings) for result in results)
    return f"{sums['cases']} cases, {failed} failed, {sums['crashes']} crashes, {sums['hangs']} hangs;"


def _load() -> str:
    return f"load average {', '.join(f'{one:.1f}' for one in os.getloadavg())}"


def _progress(target: Target, count: int):
    """A progress line on a terminal; nothing elsewhere."""
    if not sys.stderr.isatty():
        return lambda _cases: None
    return lambda cases: print(f"\r{target.name}: {cases} of {count} ", end="\r", file=sys.stderr, flush=True)


def _engine(wanted: str | None) -> str:
    """Name of the engine; prints it, with the reason when atheris is missing."""
    guided = importlib.util.find_spec("atheris") is not None
    if wanted == "atheris" and not guided:
        sys.exit("atheris is not installed: pip install 'piezod-bench[fuzz]', or --engine mutation")
    engine = wanted or ("atheris" if guided else "mutation")
    reason = "" if guided or wanted else " (atheris is not installed: cases are random, not guided by coverage)"
    print(f"engine: {engine}{reason}")
    return engine


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    for group, count in GROUPS.items():
        parser.add_argument(
            f"--{group}", type=int, default=None, metavar="N", help=f"cases ({count} when no group is named)"
        )
    parser.add_argument("--engine", choices=("mutation", "atheris"), help="default: atheris where installed")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, metavar="DIR", help="folder for inputs that fail")
    parser.add_argument("--reproduce", nargs=2, metavar=("TARGET", "FILE"), help="try one stored input")
    options = parser.parse_args()
    none_named = all(getattr(options, group) is None for group in GROUPS)
    for group, count in GROUPS.items():
        if getattr(options, group) is None:
            setattr(options, group, count if none_named else 0)
    options.keep = options.keep or Path(tempfile.gettempdir()) / "piezod-fuzz-failed"
    return options


if __name__ == "__main__":
    sys.exit(main())
