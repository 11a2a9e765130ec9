"""The child process that tries the cases of one target: `python -m tests.fuzz.worker`, started by `watch.py`.

It prints a JSON line for each finding, and may crash at any case; the shared progress names the case.
"""

import argparse
import contextlib
import gc
import importlib
import json
import os
import resource
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from tests.fuzz.shared_progress import SharedProgress
from tests.fuzz.target import Target, find_violation, peak_resident_KiB

INSTRUMENTED = [
    "piezod.config",
    "piezod.recording",
    "piezod.transport",
    "piezod.daemon.control_socket",
    "piezod.model.model_file",
    "piezod.model.parameters",
]
COMPILED = ("piezod.operators", "piezod.effects")
"""Packages that numba compiles; numba does not accept code instrumented by atheris."""

ADDRESSES_MIB = 2048
"""Address space beyond that of the imports; an input that needs more gets MemoryError, which is a finding."""

SUM_UP_EVERY = 500

Attempt = Callable[[bytes], None]


class Worker:
    """Tries inputs and reports violations.

    Parameters
    ----------
    target
        The target to try.
    progress
        The shared progress.
    count
        Number of cases to try.
    most_findings
        The worker ends after this number of findings, or when its parent has ended.
    """

    def __init__(self, target: Target, progress: SharedProgress, count: int, most_findings: int) -> None:
        self.target, self.progress, self.count, self.most_findings = target, progress, count, most_findings
        self.parent = os.getppid()
        self.seeds = target.seeds()
        self._parse = target.check()
        self.found = self.tried = self.accepted = 0
        for seed in self.seeds:  # imports, caches and buffers do not count as growth
            find_violation(self.check, seed)
        self.accepted = 0
        self.descriptors_before = _descriptors()
        self.resident_before_KiB = peak_resident_KiB()

    def attempt(self, data: bytes) -> None:
        """Try one input."""
        self.progress.begin(data)
        if what := find_violation(self.check, data):
            self.found += 1
            report({"found": what, "data": data.hex()})
        if self.found >= self.most_findings or os.getppid() != self.parent:
            self.sum_up()
            os._exit(0)
        self.progress.idle()
        self.tried += 1
        if self.tried % SUM_UP_EVERY == 0 or self.tried >= self.count:
            self.sum_up()

    def check(self, data: bytes) -> None:
        """Parse an input and count it when it is accepted."""
        self._parse(data)
        self.accepted += 1

    def mutated(self, seed: int) -> None:
        """Try inputs mutated by a seeded generator."""
        for number in range(self.count):
            random = Random(f"{self.target.name} {seed} {number}")
            self.attempt(self.target.mutate(random, random.choice(self.seeds), self.seeds))

    def guided(self, seed: int, corpus: Path) -> None:
        """Try inputs guided by code coverage, by atheris; ends the process."""
        atheris: Any = importlib.import_module("atheris")
        for number, data in enumerate(self.seeds):
            (corpus / f"seed{number}").write_bytes(data)

        def changed(data: bytes, most: int, drawn: int) -> bytes:
            random = Random(drawn)
            if random.random() < 0.5:
                return bytes(atheris.Mutate(data, most))
            begun = data if random.random() < 0.5 else random.choice(self.seeds)  # half from valid inputs
            return self.target.mutate(random, begun, self.seeds)[:most]

        largest = max(len(data) for data in self.seeds)
        options = [
            f"-runs={self.count}",
            f"-seed={seed or 1}",
            f"-max_len={2 * largest}",
            "-len_control=0",
            "-verbosity=0",
        ]
        options += ["-rss_limit_mb=0", "-timeout=1000000", "-close_fd_mask=0", f"-artifact_prefix={corpus}/"]
        atheris.Setup([sys.argv[0], *options, str(corpus)], self.attempt, custom_mutator=changed)
        atheris.Fuzz()

    def sum_up(self) -> None:
        """Store resources and counts in the shared progress."""
        peak_KiB = peak_resident_KiB()
        grown_KiB = peak_KiB - self.resident_before_KiB
        self.progress.take(peak_KiB, grown_KiB, _descriptors() - self.descriptors_before, self.accepted)


def report(what: dict[str, Any]) -> None:
    """Write one JSON line to the parent, in a single call."""
    os.write(1, json.dumps(what).encode() + b"\n")


def main() -> None:
    """Limit the address space and try the cases."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.worker", description=__doc__)
    parser.add_argument("module", help="module that holds the target")
    parser.add_argument("target")
    parser.add_argument("--engine", choices=("mutation", "atheris"), required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--most-findings", type=int, required=True)
    parser.add_argument("--folder", type=Path, required=True, help="of progress and corpus")
    options = parser.parse_args()
    progress = SharedProgress(options.folder / "progress")
    target = _load(options.module, options.target, guided=options.engine == "atheris")
    warnings.simplefilter("ignore")
    worker = Worker(target, progress, options.count, options.most_findings)
    _limit_addresses()
    if options.engine == "mutation":
        worker.mutated(options.seed)
        return
    corpus = options.folder / "corpus"
    corpus.mkdir(exist_ok=True)
    worker.guided(options.seed, corpus)


def _load(module: str, name: str, *, guided: bool) -> Target:
    watched: Any = contextlib.nullcontext()
    if guided:
        for compiled in COMPILED:
            importlib.import_module(compiled)
        watched = importlib.import_module("atheris").instrument_imports(include=INSTRUMENTED)
    with watched:
        targets: list[Target] = importlib.import_module(module).TARGETS
    return next(target for target in targets if target.name == name)


def _limit_addresses() -> None:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * os.sysconf("SC_PAGE_SIZE") + ADDRESSES_MIB * 2**20
    resource.setrlimit(resource.RLIMIT_AS, (most, most))


def _descriptors() -> int:
    gc.collect()  # descriptors held by reference cycles are not leaks
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


if __name__ == "__main__":
    main()
