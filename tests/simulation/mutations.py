"""Mutations of the program: does a test find each of them?

    python -m tests.simulation.mutations --count 60 [--seed 1] [--list]

A mutation changes one operator, condition, constant or call of a module, while the module is loaded; no file changes.
A sample is drawn. The unit tests of the module run first, then some rows of the fault list and some seeds of the
simulation, then, without `--quick`, the unit tests of the room. What nothing finds is a survivor: a missing test, or a
change that means the same.
"""

import argparse
import ast
import copy
import os
import random
import subprocess
import sys
import time
from pathlib import Path

from tests.simulation.holes import Finder

ROOT = Path(__file__).parents[2]
MODULES = {
    "piezod.control.limits": "control", "piezod.control.interlocks": "control", "piezod.control.supervisor": "control",
    "piezod.control.loop": "control", "piezod.control.device_guard": "control",
    "piezod.control.voltage_writer": "control", "piezod.control.rate_keeper": "control",
    "piezod.control.sign_check": "control", "piezod.control.arming": "control",
    "piezod.control.leaky_count": "control", "piezod.transport.register_guard": "transport",
    "piezod.transport.held_command": "transport", "piezod.transport.tick_values": "transport",
    "piezod.transport.modbus": "transport", "piezod.transport.modbus_tcp": "transport",
    "piezod.transport.modbus_rtu": "transport", "piezod.session.command_queue": "session",
    "piezod.daemon.reload": "daemon", "piezod.estimation.base.smooth_base": "estimation",
    "piezod.estimation.fit.linear_dynamics": "estimation", "piezod.estimation.fit.quadratic_program": "estimation",
    "piezod.diagnose.verdict.evidence": "diagnose", "piezod.diagnose.verdict.information": "diagnose",
    "piezod.diagnose.verdict.verdict": "diagnose", "piezod.diagnose.verdict.words": "diagnose",
}  # fmt: skip
UNSIMULATED = ("estimation", "diagnose")  # the simulated service does not load them; only the tests of the module run
NAMED_OTHERWISE = {"tick_values": "registers", "modbus": "modbus_link"}  # unit tests of a module
FLIPPED = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.And: ast.Or,
    ast.Or: ast.And,
}  # fmt: skip
ENVIRONMENT = "PIEZOD_MUTATION"
WITHIN_S = 300.0  # of the unit tests of a room, and of the simulation
SEEDS, SECONDS = 10, 7.0
QUICK_ROWS = (
    "T3", "T7", "T12", "T20", "T22", "T26", "P1", "P8", "P9", "P13", "P16", "P18", "P19", "P24", "P25", "P28", "P31",
    "M1", "M4", "M11", "V1", "V2", "V4", "V5", "V6", "V9", "V12", "V14", "C10", "C12", "R1", "R16", "R18", "R20",
)  # fmt: skip


def places(tree):
    """The places of a module that can be changed: (node, kind), in the order of the source."""
    for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
        for node in ast.walk(function):
            if isinstance(node, ast.Compare) and type(node.ops[0]) in FLIPPED:
                yield node, "comparison"
            elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in FLIPPED:
                yield node, "operator"
            elif isinstance(node, ast.If):
                yield node, "never"
                yield node, "always"
            elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
                yield node, "removed"
            elif isinstance(node, ast.Return) and isinstance(node.value, ast.Constant) and node.value.value in (0, 1):
                yield node, "returned"


def mutate(tree, number):
    """A copy of the tree with one place changed, and a line that says what."""
    tree = copy.deepcopy(tree)
    node, kind = list(places(tree))[number]
    before = ast.unparse(node).split("\n")[0]
    if kind == "comparison":
        node.ops[0] = FLIPPED[type(node.ops[0])]()
    elif kind == "operator":
        node.op = FLIPPED[type(node.op)]()
    elif kind in ("never", "always"):
        node.test = ast.Constant(kind == "always")
    elif kind == "removed":
        node.value = ast.Constant(None)
    else:
        node.value = ast.Constant(not node.value.value)
    return ast.fix_missing_locations(tree), f"line {node.lineno}: {before} -> {ast.unparse(node).splitlines()[0]}"


def every():
    """Names of all mutations, MODULE:NUMBER."""
    return [f"{module}:{n}" for module in MODULES for n in range(len(list(places(tree_of(module)))))]


class Changed:
    """A change of one module, as `holes.Hole`, which makes the code by itself."""

    def __init__(self, name):
        self.module, _, number = name.partition(":")
        self.tree, self.text = mutate(tree_of(self.module), int(number))

    def code(self, path):
        return compile(self.tree, path, "exec")


def tree_of(module):
    """Syntax tree of a module, without loading it."""
    return ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))


def apply_named():
    """Apply the mutation that the environment names, to the modules that are loaded from now on."""
    if name := os.environ.get(ENVIRONMENT):
        sys.meta_path.insert(0, Finder(Changed(name)))


def killed_by(name, quick):
    """What finds a mutation: unit, simulation, or nothing; and the processor time."""
    begun_s = time.monotonic()
    environment = os.environ | {ENVIRONMENT: name}
    module = name.partition(":")[0]
    room = ROOT / "tests" / "unit" / MODULES[module]
    last = module.rpartition(".")[2]
    pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "0", "-p", "tests.simulation.mutated",
              "-p", "no:cacheprovider", "-m", "not real_time and not slow"]  # fmt: skip
    steps = (
        ("unit", [*pytest, str(room / f"test_{NAMED_OTHERWISE.get(last, last)}.py")]),
        ("simulation", [sys.executable, "-m", "tests.simulation.mutated"]),
        ("unit", [*pytest, str(room)]),
    )
    if MODULES[module] in UNSIMULATED:
        steps = steps[:1]
    for how, command in steps[: 2 if quick else 3]:
        try:
            done = subprocess.run(
                command, env=environment, cwd=ROOT, capture_output=True, timeout=WITHIN_S, check=False
            )
        except subprocess.TimeoutExpired:
            return f"{how}: it does not end", time.monotonic() - begun_s
        if done.returncode:
            lines = done.stdout.decode("utf-8", "replace").strip().splitlines()
            shown = [line for line in lines if line.startswith(("FAILED", "ERROR", "row ", "seed "))] or lines[-1:]
            return f"{how}: {''.join(shown[:1])[:110]}", time.monotonic() - begun_s
    return "", time.monotonic() - begun_s


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.simulation.mutations", description=__doc__)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="print the sample only")
    parser.add_argument("--quick", action="store_true", help="without the unit tests of the whole room")
    parser.add_argument("--only", nargs="*", help="mutations by name, MODULE:NUMBER")
    wanted = parser.parse_args()
    known = every()
    sample = wanted.only or random.Random(wanted.seed).sample(known, wanted.count)
    counts = {"unit": 0, "simulation": 0, "": 0}
    for name in sample:
        text = Changed(name).text
        found, took_s = ("", 0.0) if wanted.list else killed_by(name, wanted.quick)
        counts[found.partition(":")[0]] += 1
        print(f"{name} {text}", "" if wanted.list else f"\n    {found or 'SURVIVED'} ({took_s:.0f} s)", flush=True)
    unit, simulation, survived = counts.values()
    print(f"{len(sample)} of {len(known)} mutations: {unit} found by unit tests, {simulation} more by the simulation")
    print(f"{survived} survived")
    return int(counts[""] > 0)


if __name__ == "__main__":
    sys.exit(main())
