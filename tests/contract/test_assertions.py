"""Every test asserts, expects an error or a warning, or calls a function of the tests that does."""

import ast
from pathlib import Path

TESTS = Path(__file__).parents[1]
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in TESTS.rglob("*.py")}
FUNCTIONS = [
    node
    for tree in TREES.values()
    for node in ast.walk(tree)
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
]


def called(function):
    """Names of the functions and methods that a function calls."""
    names = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return {getattr(name, "attr", getattr(name, "id", "")) for name in names}


def asserts(function):
    expects = any(name in {"raises", "warns"} or name.startswith("assert_") for name in called(function))
    return expects or any(isinstance(node, ast.Assert) for node in ast.walk(function))


def test_every_test_asserts():
    checks = {function.name for function in FUNCTIONS if asserts(function)}
    silent = [
        f"{path}: {node.name}"
        for path, tree in TREES.items()
        if path.name.startswith("test_")
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_")
        if not asserts(node) and called(node).isdisjoint(checks)
    ]
    assert silent == []
