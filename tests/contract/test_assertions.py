"""Every test asserts, expects an error or a warning, or calls a function of the tests that does."""

import ast
from pathlib import Path

TESTS = Path(__file__).parents[1]
FUNCTION = (ast.FunctionDef, ast.AsyncFunctionDef)


def called(function):
    """Names of the functions and methods that a function calls."""
    names = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return {getattr(name, "attr", getattr(name, "id", "")) for name in names}


def asserts(function):
    expects = any(name in {"raises", "warns"} or name.startswith("assert_") for name in called(function))
    return expects or any(isinstance(node, ast.Assert) for node in ast.walk(function))


def test_every_test_asserts():
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in TESTS.rglob("*.py")}
    functions = {path: [one for one in ast.walk(tree) if isinstance(one, FUNCTION)] for path, tree in trees.items()}
    checks = {function.name for found in functions.values() for function in found if asserts(function)}
    silent = [
        f"{path}: {one.name}"
        for path, found in functions.items()
        if path.name.startswith("test_")
        for one in found
        if one.name.startswith("test_") and not asserts(one) and called(one).isdisjoint(checks)
    ]
    assert silent == []
