"""The analysis half runs where the modules and functions of POSIX systems are missing, as on Windows.

A subprocess blocks those modules and deletes those functions before it imports piezod.
"""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "config" / "model.yaml"
BENCH = ROOT / "config" / "bench.yaml"

BLOCKED = """
import os, sys

MODULES = set(
    "crypt curses fcntl grp nis pty pwd readline resource spwd syslog termios tty".split()
)
FUNCTIONS = (
    "chown fchmod fchown getegid geteuid getgid getloadavg getpgid getuid killpg mkfifo posix_fallocate pread pwrite "
    "sched_getaffinity sched_setaffinity sched_setscheduler setsid O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_NONBLOCK"
).split()


class Blocks:
    def find_spec(self, name, path=None, target=None):
        if name in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


for name in MODULES:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Blocks())
for name in FUNCTIONS:
    delattr(os, name)
import select
del select.epoll
"""

INTERFACE = """
import numpy as np
import piezod

stack = piezod.Model.load(sys.argv[1])
time_s = np.arange(0.0, 12.0, 0.005)
voltage_V = 11.0 * time_s * (1.0 - abs(1.0 - time_s % 2.0))
noise_N = np.random.default_rng(1).normal(0.0, 0.1, time_s.size)
force_N = piezod.simulate(piezod.Recording(time_s, {"voltage_V": voltage_V}), stack).channel("force_N") + noise_N
found = piezod.identify(piezod.Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N}))
late_N = np.concatenate((np.full(6, force_N[0]), force_N[:-6])) + noise_N[::-1]
diagnosis = piezod.diagnose(piezod.Recording(time_s, {"voltage_V": voltage_V, "force_N": late_N}), found)
found.write_page("identified.html")
diagnosis.write_page("diagnosed.html")
print(found.useful, diagnosis.effects)
"""

COMMANDS = """
import piezod.cli

sys.argv[0] = "piezod"
piezod.cli.main()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("analysis")


def python(folder, code, *arguments):
    command = [sys.executable, "-c", BLOCKED + code, *map(str, arguments)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=300)


@pytest.fixture(scope="module")
def recording(folder):
    import numpy as np

    from piezod.model import load_model
    from piezod.recording import Recording, write_recording

    time_s = np.arange(0.0, 12.0, 0.01)
    voltage_V = 11.0 * time_s * (1.0 - abs(1.0 - time_s % 2.0))
    force_N = load_model(MODEL).operator().run(voltage_V) + np.random.default_rng(1).normal(0.0, 0.1, time_s.size)
    path = folder / "work.csv"
    write_recording(Recording(time_s, {"voltage_V": voltage_V, "force_N": force_N}), path)
    return path


@pytest.mark.parametrize("module", ["fcntl", "resource", "termios"])
def test_the_block_hides_a_module(folder, module):
    done = python(folder, f"import {module}")
    assert f"No module named '{module}'" in done.stderr


def test_the_python_interface_identifies_simulates_and_diagnoses(folder):
    done = python(folder, INTERFACE, MODEL)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "True ('transport_delay',)\n"


@pytest.mark.parametrize(
    "line",
    [
        "identify {recording} -o {out}/model.yaml --report {out}/page",
        "simulate {recording} --model {model} -o {out}/simulated.csv",
        "compare {recording} --model {model}",
        "resid {recording} --model {model}",
        "testable {recording} --model {model}",
        "convert {recording} -o {out}/work.sqlite",
        "effects creep",
        "docs api",
        "--version",
        "--help",
    ],
    ids=lambda line: line.split()[0],
)
def test_a_command_of_the_analysis_ends_with_0(line, folder, recording, tmp_path):
    arguments = line.format(recording=recording, model=MODEL, out=tmp_path).split()
    done = python(folder, COMMANDS, *arguments)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_a_lack_of_descriptors_is_named_without_their_limit(folder):
    done = python(
        folder, "from piezod.cli.root import _shortage; import errno; print(_shortage(OSError(errno.EMFILE, '')))"
    )
    assert done.stdout == "too many open files; end other programs\n", done.stderr


@pytest.mark.parametrize("line", ["run {bench}", "check {bench}", "record {bench} --excitation staircase -o x.csv"])
def test_a_command_that_drives_says_in_a_line_that_it_needs_linux(line, folder):
    done = python(folder, COMMANDS, *line.format(bench=BENCH).split())
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("piezod: this command is for a bench and needs Linux")
