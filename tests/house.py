"""The house in figures: how much code there is, and how often the same thing is in it.

    python -m tests.house                 # each figure beside its limit
    python -m tests.house --places FIGURE # where it was counted
    python -m tests.house --tighten       # write the figures that have fallen into tests/house.yaml

`tests/contract/test_house.py` holds the figures to their limits, which only fall.
"""

import argparse
import ast
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import yaml

from piezod.effects import EFFECTS

ROOT = Path(__file__).parents[1]
LIMITS = ROOT / "tests" / "house.yaml"
SMALL_FILE, LARGE_FILE, LONG_FUNCTION = 60, 400, 60  # lines
ESTIMATOR = ("fit", "estimation", "identify", "diagnose")
HOLDERS = ("recording", *ESTIMATOR)
FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)
ARRAYS_OF_A_RECORDING = 2  # its time or input, and its output


@dataclass(frozen=True)
class Module:
    """One file of the package."""

    path: Path

    @cached_property
    def text(self):
        return self.path.read_text(encoding="utf-8")

    @cached_property
    def nodes(self):
        return list(ast.walk(ast.parse(self.text)))

    @property
    def name(self):
        return self.path.relative_to(ROOT).as_posix()

    @property
    def room(self):
        parts = self.path.relative_to(ROOT / "piezod").parts
        return parts[0] if len(parts) > 1 else "package"

    @property
    def lines(self):
        return self.text.count("\n")

    def code_lines(self):
        """Number of lines that are neither blank, comment, docstring nor import."""
        skipped = set()
        for node in self.nodes:
            if (
                isinstance(node, (ast.Module, ast.ClassDef, *FUNCTION))
                and ast.get_docstring(node, clean=False) is not None
            ):
                skipped |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                skipped |= set(range(node.lineno, node.end_lineno + 1))
        lines = enumerate(self.text.split("\n"), 1)
        return sum(k not in skipped and bool(line.strip()) and not line.strip().startswith("#") for k, line in lines)

    def place(self, node, name):
        return f"{self.name}:{node.lineno} {name}"


def modules():
    """All modules of piezod, by path."""
    return [Module(path) for path in sorted((ROOT / "piezod").rglob("*.py"))]


def imported_names(module):
    imports = [node for node in module.nodes if isinstance(node, (ast.Import, ast.ImportFrom))]
    return [module.place(node, alias.name) for node in imports for alias in node.names]


def deciding_constants(module):
    """Upper-case numbers of a module of the estimator, alone or in a literal.

    Those of `rules.py` have one place. Units, sizes of arrays and numbers of steps count too: only a reader can tell
    which of them decide.
    """
    if module.room not in ESTIMATOR or module.path.name == "rules.py":
        return []
    found = []
    for node in module.nodes[0].body:
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or node.value is None or not _has_number(node.value):
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
        found += [module.place(node, name) for name in names if name.isupper()]
    return found


def _has_number(value):
    """Whether an expression holds a numeric literal outside calls and strings."""
    if isinstance(value, ast.Constant):
        return isinstance(value.value, (int, float)) and not isinstance(value.value, bool)
    return not isinstance(value, ast.Call) and any(_has_number(child) for child in ast.iter_child_nodes(value))


def recording_classes(module):
    """Classes in the path of a recording with two or more fields that are arrays."""
    if module.room not in HOLDERS:
        return []
    found = []
    for node in module.nodes:
        if isinstance(node, ast.ClassDef):
            types = [ast.unparse(one.annotation) for one in node.body if isinstance(one, ast.AnnAssign)]
            if sum("Array" in one for one in types) >= ARRAYS_OF_A_RECORDING:
                found.append(module.place(node, node.name))
    return found


def left_out_formulas(module):
    """Terms `- 2 * a @ b` of the estimator: the middle term of a loss computed from sums of products."""
    if module.room not in ESTIMATOR:
        return []
    differences = [node for node in module.nodes if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Sub)]
    return [module.place(node, ast.unparse(node.right)) for node in differences if _is_twice_a_product(node.right)]


def _is_twice_a_product(node):
    if not isinstance(node, ast.BinOp):
        return False
    if isinstance(node.op, ast.MatMult):
        left = node.left
        return isinstance(left, ast.BinOp) and isinstance(left.op, ast.Mult) and _is_two(left.left)
    return isinstance(node.op, ast.Mult) and _is_two(node.left) and "@" in ast.unparse(node.right)


def _is_two(node):
    return isinstance(node, ast.Constant) and node.value == 2


def quoted_effects(module):
    """Names of effects as strings outside the folder of the effects: what holds for one effect belongs to its file."""
    if module.room == "effects":
        return []
    strings = [one for one in module.nodes if isinstance(one, ast.Constant) and isinstance(one.value, str)]
    return [module.place(one, one.value) for one in strings if one.value in EFFECTS]


def functions(module):
    return [node for node in module.nodes if isinstance(node, FUNCTION)]


def long_functions(module):
    over = [one for one in functions(module) if one.end_lineno - one.lineno + 1 > LONG_FUNCTION]
    return [module.place(one, one.name) for one in over]


def noise_functions(module):
    return [module.place(one, one.name) for one in functions(module) if "noise" in one.name]


PLACES = {
    "files": lambda module: [module.name],
    "files below 60 lines": lambda module: [module.name] * (module.lines < SMALL_FILE),
    "files above 400 lines": lambda module: [module.name] * (module.lines > LARGE_FILE),
    "imported names": imported_names,
    "numbers of the estimator outside rules.py": deciding_constants,
    "classes of two or more arrays": recording_classes,
    "places of the left-out formula": left_out_formulas,
    "quoted names of effects": quoted_effects,
    "functions above 60 lines": long_functions,
    "functions named noise": noise_functions,
}
"""Figures that are a number of places, and what lists those of one module."""


def figures():
    """Each figure by its name: the lines of code, those of each room, and the numbers of places."""
    rooms, counted = Counter(), dict.fromkeys(PLACES, 0)
    for module in modules():
        rooms[module.room] += module.code_lines()
        for name, places in PLACES.items():
            counted[name] += len(places(module))
    files = [path for path in (ROOT / "tests").rglob("*.py") if not path.name.startswith("test_")]
    support = sum(path.read_text(encoding="utf-8").count("\n") for path in files)
    by_room = {f"code lines of {room}": rooms[room] for room in sorted(rooms)}
    return {"code lines": rooms.total(), **counted, "lines of support of the tests": support, **by_room}


def limits():
    """Each limit by the name of its figure."""
    return yaml.safe_load(LIMITS.read_text(encoding="utf-8"))


def tighten(measured):
    """Lower the limits to the figures; a limit without a figure goes, a figure above its limit keeps the limit."""
    old = limits() if LIMITS.exists() else {}
    lowered = {name: min(value, old.get(name, value)) for name, value in measured.items()}
    LIMITS.write_text("".join(f"{name}: {value}\n" for name, value in lowered.items()), encoding="utf-8")


def main():
    """Print the table, or the places of one figure; or lower the limits."""
    parser = argparse.ArgumentParser(prog="python -m tests.house", description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--places", choices=PLACES, metavar="FIGURE", help="; ".join(PLACES))
    parser.add_argument("--tighten", action="store_true", help="lower the limits to the figures")
    given = parser.parse_args()
    if given.places:
        print(*(place for module in modules() for place in PLACES[given.places](module)), sep="\n")
        return
    measured = figures()
    if given.tighten:
        tighten(measured)
    allowed = limits()
    for name, value in measured.items():
        print(f"{name:42} {value:6} of {allowed.get(name, '-'):>6}")


if __name__ == "__main__":
    main()
