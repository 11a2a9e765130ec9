"""The child that tries the cases of one target: `python -m tests.fuzz.worker`, started by `watch.py`.

It prints a JSON line for each finding, and may die at any case: the board says at which.
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

from tests.fuzz.board import Board
from tests.fuzz.target import Target, judge, peak_resident_KiB

INSTRUMENTED = [
    "piezod.config",
    "piezod.recording",
    "piezod.transport",
    "piezod.daemon.control_socket",
    "piezod.model.model_file",
    "piezod.model.parameters",
]
COMPILED = ("piezod.operators", "piezod.effects")
"""Rooms that numba compiles: what atheris writes into their code it would not understand."""

ADDRESSES_MIB = 2048
"""Address space beyond what the imports took: an input that wants more is met with MemoryError, which is a finding."""

SUM_UP_EVERY = 500

Attempt = Callable[[bytes], None]


class Worker:
    """Tries inputs and says what was found.

    Parameters
    ----------
    target
        What is tried.
    board
        Where the case is written down.
    count
        How many are to be tried.
    most_findings
        After so many it ends; so it does when its parent has gone.
    """

    def __init__(self, target: Target, board: Board, count: int, most_findings: int) -> None:
        self.target, self.board, self.count, self.most_findings = target, board, count, most_findings
        self.parent = os.getppid()
        self.seeds = target.seeds()
        self._parse = target.check()
        self.found = self.tried = self.accepted = 0
        for seed in self.seeds:  # imports, caches and buffers are no growth
            judge(self.check, seed)
        self.accepted = 0
        self.descriptors_before = _descriptors()
        self.resident_before_KiB = peak_resident_KiB()

    def attempt(self, data: bytes) -> None:
        """Try one input."""
        self.board.begin(data)
        if what := judge(self.check, data):
            self.found += 1
            say({"found": what, "data": data.hex()})
        if self.found >= self.most_findings or os.getppid() != self.parent:
            self.sum_up()
            os._exit(0)
        self.board.idle()
        self.tried += 1
        if self.tried % SUM_UP_EVERY == 0 or self.tried >= self.count:
            self.sum_up()

    def check(self, data: bytes) -> None:
        """Have it parsed; count what is not refused."""
        self._parse(data)
        self.accepted += 1

    def mutated(self, seed: int) -> None:
        """Inputs drawn from a seeded generator."""
        for number in range(self.count):
            random = Random(f"{self.target.name} {seed} {number}")
            self.attempt(self.target.mutate(random, random.choice(self.seeds), self.seeds))

    def guided(self, seed: int, corpus: Path) -> None:
        """Inputs chosen by what they reach in the code, by atheris; ends the process."""
        atheris: Any = importlib.import_module("atheris")
        for number, data in enumerate(self.seeds):
            (corpus / f"seed{number}").write_bytes(data)

        def changed(data: bytes, most: int, drawn: int) -> bytes:
            random = Random(drawn)
            if random.random() < 0.5:
                return bytes(atheris.Mutate(data, most))
            begun = data if random.random() < 0.5 else random.choice(self.seeds)  # some changes from what is valid
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
        """Write down what the cases took."""
        peak_KiB = peak_resident_KiB()
        grown_KiB = peak_KiB - self.resident_before_KiB
        self.board.take(peak_KiB, grown_KiB, _descriptors() - self.descriptors_before, self.accepted)


def say(what: dict[str, Any]) -> None:
    """One line to the parent, in one piece."""
    os.write(1, json.dumps(what).encode() + b"\n")


def main() -> None:
    """Parse, limit, try."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.worker", description=__doc__)
    parser.add_argument("module", help="where the target is")
    parser.add_argument("target")
    parser.add_argument("--engine", choices=("mutation", "atheris"), required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--most-findings", type=int, required=True)
    parser.add_argument("--folder", type=Path, required=True, help="of board and corpus")
    options = parser.parse_args()
    board = Board(options.folder / "board")
    target = _load(options.module, options.target, guided=options.engine == "atheris")
    warnings.simplefilter("ignore")
    worker = Worker(target, board, options.count, options.most_findings)
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
    gc.collect()  # what a cycle still holds is no leak
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


if __name__ == "__main__":
    main()
