"""How soon a command answers: its help, and the refusal of a wrong file, against an interpreter that does nothing."""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from time import perf_counter

from tests.benchmarks.table import Row

MOST_HELP_S, MOST_REFUSAL_S = 0.3, 1.0
ROUNDS = 5
REFUSALS = {
    "identify": "identify {wrong} -o {out}/m.yaml",
    "simulate": "simulate {wrong} --model {model} -o {out}/s.csv",
    "diagnose": "diagnose {wrong} --model {model} -o {out}/d",
    "testable": "testable {wrong} --model {model}",
    "compare": "compare {wrong} --model {model}",
    "resid": "resid {wrong} --model {model}",
    "report": "report {wrong} -o {out}/r.html",
    "convert": "convert {wrong} -o {out}/c.h5",
    "run": "run {wrong}",
    "check": "check {wrong}",
    "record": "record {wrong} --excitation constant-triangles -o {out}/x.csv",
    "validate": "validate {wrong} --model {model}",
    "watch": "watch {wrong}",
    "bridge": "bridge {wrong} --opcua 4840",
    "blind run": "blind run {wrong} -o {out}/v",
}


def measure(*, quick: bool) -> Iterator[Row]:
    """Rows for the help of `piezod` and the refusal of each command."""
    rounds = 2 if quick else ROUNDS
    bare_s = _median_s([sys.executable, "-c", "pass"], rounds, 0)
    help_s = _median_s([sys.executable, "-m", "piezod", "--help"], rounds, 0)
    yield Row("commands", "piezod --help", "s", help_s, bare_s, "an interpreter that does nothing", most=MOST_HELP_S)
    with tempfile.TemporaryDirectory() as folder:
        wrong = Path(folder) / "wrong.csv"
        wrong.write_text("a file of words\nand no numbers\n", encoding="utf-8")
        named = {"wrong": wrong, "out": folder, "model": "config/model.yaml"}
        for name, line in REFUSALS.items():
            taken_s = _median_s([sys.executable, "-m", "piezod", *line.format(**named).split()], rounds, None)
            what = f"{name}: refusal of a wrong file"
            yield Row("commands", what, "s", taken_s, bare_s, "an interpreter that does nothing", most=MOST_REFUSAL_S)


def _median_s(command: list[str], rounds: int, code: int | None) -> float:
    """Duration of a command that ends with a code; None: with any but 0."""
    durations_s = []
    for _ in range(rounds):
        begun_s = perf_counter()
        done = subprocess.run(command, capture_output=True, check=False)
        durations_s.append(perf_counter() - begun_s)
        assert (done.returncode != 0) if code is None else (done.returncode == code), done.stderr
    return median(durations_s)
