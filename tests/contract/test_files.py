"""Every file is written by `piezod/runtime/files.py`, and the service reads none that could make it wait."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import piezod
from piezod.runtime.interpreter import python

ROOT = Path(piezod.__file__).parent
SERVICE = ("control", "transport", "session", "recorder", "daemon", "bridge", "commissioning", "config", "model")
WRITERS = {
    "blind/": "a study's own new folder",
    "history/worker.py": "the new folder of a child",
    "tasks/": "the new folder of a child",
    "recording/formats/": "a part that `replaced` has made",
    "commissioning/emulator.py": "a new temporary folder",
    "control/realtime.py": "a device file of the kernel",
    "runtime/files.py": "the one writer",
}
READERS = {
    "config/regular_file.py": "a file that `is_file` has seen, beside a missing one",
    "session/control_process.py": "files of the kernel",
    "transport/serial_port.py": "files of the kernel",
    "commissioning/check_machine.py": "files of the kernel",
    "commissioning/init.py": "shipped files",
    "commissioning/emulator.py": "shipped files",
    "commissioning/manual.py": "shipped files",
}


def calls(path):
    """Calls that open a file, as (line, what): `write` or `read`."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        owner = ast.unparse(node.func.value) if isinstance(node.func, ast.Attribute) else ""
        modes = [a.value for a in (*node.args, *(k.value for k in node.keywords)) if isinstance(a, ast.Constant)]
        mode = next((one for one in modes if isinstance(one, str) and set(one) <= set("rwaxbt+")), None)
        if name in ("write_text", "write_bytes", "mkstemp", "NamedTemporaryFile") or (
            name in ("replace", "rename") and (owner == "os" or (len(node.args) == 1 and not node.keywords))
        ):
            yield node.lineno, "write"
        elif name == "open" and (owner or isinstance(node.func, ast.Name)) and mode is not None:
            yield node.lineno, "write" if set(mode) & set("wax+") else "read"
        elif name in ("read_text", "read_bytes") or (
            name == "open" and any(k.arg == "encoding" for k in node.keywords)
        ):
            yield node.lineno, "read"


def beside(kind, rooms, permitted):
    """Places beside the one function, and permitted names that need the permission."""
    found, used = [], set()
    for path in sorted(ROOT.rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if rooms and name.partition("/")[0] not in rooms:
            continue
        for line, what in calls(path):
            if what == kind:
                allowed = next((one for one in permitted if name.startswith(one)), None)
                found += [f"{name}:{line}"] if allowed is None else []
                used.add(allowed)
    return found, set(permitted) - used


def test_no_file_is_written_beside_the_one_writer():
    assert beside("write", None, WRITERS) == ([], set())


def test_no_room_of_the_service_reads_a_file_that_could_make_it_wait():
    assert beside("read", SERVICE, READERS) == ([], set())


def test_a_call_beside_the_writer_is_seen(tmp_path):
    path = tmp_path / "room.py"
    path.write_text(
        "p.write_text('')\nopen(p, 'w')\np.open('rb')\np.read_text()\na.replace(b)\nos.rename(a, b)\n"
        "s.replace('a', 'b')\nreplace(a, b=1)\nserver.open()\np.open(encoding='utf-8')\n"
    )
    assert [*calls(path)] == [
        (1, "write"), (2, "write"), (3, "read"), (4, "read"), (5, "write"), (6, "write"), (10, "read"),
    ]  # fmt: skip


CHILDREN = {
    "recorder": python("-m", "piezod.recorder.writer", "x"),
    "console": [sys.executable, "-m", "piezod", "--version"],
    "emulator": python("-m", "firmware_sim", "--help"),
    "workbook": python("-c", "import piezod.recording.formats.spreadsheet_export, numpy, yaml, sqlite3"),
    "multiprocessing": python(
        "-c",
        "from piezod.runtime.processes import spawn_context\n"
        "import platform\np = spawn_context().Process(target=platform.machine)\np.start(); p.join()",
    ),
}


def foreign_modules_run(folder, command):
    """Whether a child that is started in a folder with modules of usual names runs one of them."""
    mark = folder / "mark"
    for name in ("sqlite3", "numpy", "json", "yaml", "pickle", "struct", "asyncio", "typer"):
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write({name!r} + ' ')\nraise SystemExit(9)\n")
    environment = os.environ | {"PYTHONPATH": str(ROOT.parent)}
    environment.pop("PYTHONSAFEPATH", None)
    subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=60, check=False)
    return mark.exists()


@pytest.mark.parametrize("child", CHILDREN)
def test_no_child_imports_from_the_current_folder(tmp_path, child):
    assert not foreign_modules_run(tmp_path, CHILDREN[child])


@pytest.mark.parametrize("child", [child for child, command in CHILDREN.items() if "-P" in command])
def test_a_child_that_is_started_otherwise_does_import_from_the_current_folder(tmp_path, child):
    assert foreign_modules_run(tmp_path, [part for part in CHILDREN[child] if part != "-P"])


def test_every_child_is_started_by_the_one_command():
    others = [p for p in sorted(ROOT.rglob("*.py")) if "sys.executable" in p.read_text(encoding="utf-8")]
    assert [path.relative_to(ROOT).as_posix() for path in others] == ["runtime/interpreter.py"]
