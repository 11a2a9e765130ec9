"""The first day of a user, as a transcript with a stopwatch: `python -m tests.studies new_user [-o FOLDER] [--clone]`.

Demo, own CSV of another instrument, own bench on the emulator, a change of the bench, a second change, history. Each
command is the one that a user types. The times are wall seconds of this machine.
"""

import argparse
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from firmware_sim.physics.bench import Bench
from firmware_sim.physics.scenario import load_scenario
from tests.benches.emulator import EMULATOR, ROOT, emulator

SHOWN = 6  # lines of a command's output, from its end
DRIVEN_V, RATE_HZ = 120.0, 200
CREEP = ({"creep": {"per_decade": 0.02}}, {"creep": {"per_decade": 0.03}})
LIMITS = {"stale_after_ms": 40, "comm_loss_ms": 9000, "device_watchdog_ms": 8000, "missed_ticks_in_a_row": 2000}


@dataclass
class Day:
    """Commands of the day with their times.

    Parameters
    ----------
    folder
        Working folder of the user.
    steps
        Name of a chapter, command, duration [s] and exit code.
    """

    folder: Path
    program: Sequence[str]
    chapter: str = ""
    steps: list[tuple[str, str, float, int]] = field(default_factory=list)

    def begin(self, chapter: str) -> None:
        """Print the heading of a chapter."""
        self.chapter = chapter
        print(f"\n## {chapter}", flush=True)

    def piezod(self, *words: object) -> str:
        """Run a command of piezod, print its last lines and its time, and return its output."""
        return self.run([*self.program, *map(str, words)], shlex.join(["piezod", *map(str, words)]))

    def run(self, command: Sequence[str], shown: str) -> str:
        """Run a command, print its last lines and its time, and return its output."""
        print(f"\n$ {shown}", flush=True)
        begun_s = time.monotonic()
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=False)
        took_s = time.monotonic() - begun_s
        lines = (done.stdout + (done.stderr if done.returncode else "")).strip().splitlines()
        print("\n".join(f"  {line}" for line in lines[-SHOWN:]))
        print(f"  [{took_s:.1f} s, exit {done.returncode}]", flush=True)
        self.steps.append((self.chapter, shown, took_s, done.returncode))
        return done.stdout


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the study."""
    parser.add_argument("-o", "--output", type=Path, help="folder of the day; default: a temporary one")
    parser.add_argument("--clone", action="store_true", help="begin with a fresh clone and environment, by pip")
    parser.add_argument("--whole-demo", action="store_true", help="the demo with its diagnosis")
    parser.set_defaults(run=lambda options, _: run(options.output, clone=options.clone, whole_demo=options.whole_demo))


def run(output: Path | None, *, clone: bool = False, whole_demo: bool = False) -> Day:
    """Live the day, and print its table of times."""
    if output is None:
        with tempfile.TemporaryDirectory() as name:
            return run(Path(name), clone=clone, whole_demo=whole_demo)
    output.mkdir(parents=True, exist_ok=True)
    day = Day(output, [sys.executable, "-m", "piezod"])
    if clone:
        _install(day)
    day.begin("Demo")
    day.piezod("demo", *([] if whole_demo else ["--quick"]), "--report", "demo.html")
    _own_csv(day)
    _own_bench(day)
    print(table(day))
    return day


def table(day: Day) -> str:
    """Time of each chapter and of the whole day."""
    chapters = dict.fromkeys(step[0] for step in day.steps)
    rows = [(name, [step for step in day.steps if step[0] == name]) for name in chapters]
    lines = [f"{name:34}{len(steps):9}{sum(step[2] for step in steps):9.1f}" for name, steps in rows]
    whole = f"{'whole day':34}{len(day.steps):9}{sum(step[2] for step in day.steps):9.1f}"
    return "\n".join(["", f"{'chapter':34}{'commands':>9}{'time [s]':>9}", *lines, whole])


def _install(day: Day) -> None:
    day.begin("Fresh clone")
    clone = day.folder / "clone"
    day.run(["git", "clone", "-q", str(ROOT), str(clone)], "git clone piezod")
    day.run([sys.executable, "-m", "venv", str(clone / ".venv")], "python3 -m venv .venv")
    day.run([str(clone / ".venv/bin/pip"), "install", "-q", "-e", str(clone)], ".venv/bin/pip install -e .")
    day.program = [str(clone / ".venv" / "bin" / "piezod")]


def _own_csv(day: Day) -> None:
    """Two recordings of another instrument, with commas, German names and milliseconds."""
    day.begin("Own recording")
    for name, effects, seed in (("before", {}, 1), ("later", CREEP[0], 2)):
        _write_foreign(day.folder / f"{name}.csv", effects, seed)
    day.piezod("identify", "before.csv", "-o", "own.yaml", "--report", "own")
    day.piezod("diagnose", "later.csv", "--model", "own.yaml", "-o", "own-diagnosis")
    day.piezod("compare", "later.csv", "--model", "own.yaml", "--model", "own-diagnosis/model.yaml")


def _write_foreign(path: Path, effects: dict[str, dict[str, float]], seed: int) -> None:
    time_s = np.arange(0.0, 60.0, 1.0 / RATE_HZ)
    size = 1.0 - 0.7 * np.floor(time_s / 10.0) / 6.0
    voltage_V = 0.5 * DRIVEN_V * (1.0 - np.cos(2.0 * np.pi * 0.2 * time_s)) * size
    scenario = load_scenario("stack", {"load_cell": {"white_noise_N": 0.05}, "effects": effects})
    force_N = Bench(scenario, seed=seed).run(voltage_V, 1.0 / RATE_HZ)
    rows = zip(1e3 * time_s, voltage_V, force_N, strict=True)
    lines = [f"{t:.1f};{u:.4f};{f:.4f}".replace(".", ",") for t, u, f in rows]
    path.write_text("\n".join(["Zeit [ms];U [V];Kraft [N]", *lines, ""]), encoding="utf-8")


def _own_bench(day: Day) -> None:
    """A bench file, checks, model, drive, and two changes of the bench."""
    day.begin("Own bench")
    with _device(day.folder, {}) as (host, port):
        day.piezod("init", "--discover", "--host", host, "--port", port)
        given = ("--profile", "bench", "--name", "press", "--host", host, "--port", port, "--rate", RATE_HZ)
        day.piezod("init", "--yes", *given, "-o", "bench.yaml", "--force")
        _adapt(day.folder / "bench.yaml", port)
        day.piezod("config", "check", "bench.yaml")
        day.piezod("record", "bench.yaml", "--excitation", "varying-triangles", "-o", "first.csv", "--force")
        day.piezod("identify", "first.csv", "-o", "models/model.yaml", "--report", "first", "--force")
        day.piezod("check", "bench.yaml")
        day.piezod("validate", "bench.yaml", "--model", "models/model.yaml", "--report", "validation.html")
    model = "models/model.yaml"
    for number, effects in enumerate(CREEP, 1):
        day.begin(f"Change {number} of the bench")
        with _device(day.folder, effects) as (_, port):
            _adapt(day.folder / "bench.yaml", port)
            work = f"work_{number}.csv"
            excitation = "staircase-minor-loops-multisine"
            day.piezod("record", "bench.yaml", "--excitation", excitation, "-o", work, "--force")
        folder = f"models/diagnosis_{number}"
        day.piezod("diagnose", work, "--model", model, "-o", folder, "--force")
        model = f"{folder}/model.yaml"
    day.begin("History")
    day.piezod("history", "models")


@contextmanager
def _device(folder: Path, effects: dict[str, dict[str, float]]) -> Iterator[tuple[str, int]]:
    """Host and port of an emulated bench in virtual time."""
    config = folder / "emulator.yaml"
    content = yaml.safe_load(EMULATOR.read_text(encoding="utf-8")) | {"effects": effects}
    config.write_text(yaml.safe_dump(content), encoding="utf-8")
    with emulator("--port", "0", "--time", "virtual", config=config) as serves:
        host, _, port = serves["tcp"].rpartition(":")
        yield host, int(port)


def _adapt(path: Path, port: int) -> None:
    """The edits of the user: port, model, and limits for a device that does not run in real time."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    content["link"] |= {"port": port, "timeout_s": 0.5}
    content["limits"] |= LIMITS
    content["model"] = "models/model.yaml"
    (path.parent / "models").mkdir(exist_ok=True)
    content["daemon"] |= {"ring_log": str(path.parent.resolve() / "ring")}
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
