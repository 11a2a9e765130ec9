"""Compiled functions have a place also where nothing of the user or of the package is writable."""

import os
import subprocess
import sys
from pathlib import Path

import pytest


def _run(script, **environment):
    variables = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"} | environment
    return subprocess.run(
        [sys.executable, script], env=variables, capture_output=True, text=True, check=True, timeout=120
    )


COMPILED = """
import os
os.access = lambda *_, **__: {writable}
import piezod, numba

@numba.njit(cache=True)
def twice(x):
    return 2.0 * x

print(numba.config.CACHE_DIR)
"""


def _script(tmp_path, *, writable, more=""):
    path = tmp_path / "compile.py"
    path.write_text(COMPILED.format(writable=writable) + more, encoding="utf-8")
    return str(path)


def test_a_private_folder_is_used_and_removed_and_reported(tmp_path):
    done = _run(_script(tmp_path, writable=False, more="twice(1.0)\n"), TMPDIR=str(tmp_path))
    folder = Path(done.stdout.strip())
    assert folder.parent == tmp_path
    assert folder.name.startswith("piezod-compiled-")
    assert not folder.exists()
    assert done.stderr.count("\n") == 1
    assert "no writable place for compiled code" in done.stderr
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_a_command_that_compiles_nothing_reports_nothing(tmp_path):
    done = _run(_script(tmp_path, writable=False), TMPDIR=str(tmp_path))
    assert done.stderr == ""
    assert not Path(done.stdout.strip()).exists()


def test_a_child_uses_the_folder_of_its_parent_and_leaves_it(tmp_path):
    child = "import subprocess, sys; child = 'import piezod, os; print(os.environ[\"NUMBA_CACHE_DIR\"])'\n"
    child += "print(subprocess.check_output([sys.executable, '-c', child], text=True).strip())\n"
    child += "os.stat(os.environ['NUMBA_CACHE_DIR'])  # it fails if the child removed it\n"
    done = _run(_script(tmp_path, writable=False, more=child), TMPDIR=str(tmp_path))
    own, of_child = done.stdout.split()
    assert own == of_child


@pytest.mark.parametrize(
    ("writable", "given", "used"), [(True, {}, ""), (False, {"NUMBA_CACHE_DIR": "/somewhere"}, "/somewhere")]
)
def test_a_writable_place_and_the_user_come_first(tmp_path, writable, given, used):
    done = _run(_script(tmp_path, writable=writable), **given)
    assert done.stdout.strip() == used
