"""Processes of `piezod` and `firmware_sim`, forked from one process that has imported them.

An import takes most of a second of processor time, and the tests start about a thousand processes. A forked process
runs its module from the first line, with its own arguments, folder, environment and files. It is a child of the test
process, like one that `subprocess` starts. The control process is started by the daemon, and imports on its own.
"""

import atexit
import ctypes
import gc
import importlib
import inspect
import json
import os
import runpy
import socket
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
MODULES = ("piezod", "firmware_sim", "tests.faults.emulated_device")
PRELOADED = (
    "piezod.cli",
    "piezod.commissioning.check",
    "piezod.commissioning.record",
    "piezod.commissioning.validate",
    "piezod.daemon.run",
    "piezod.daemon.service",
    "piezod.diagnose",
    "piezod.identify",
    "piezod.recorder.watch",
    "piezod.session.control_process",
    "firmware_sim.server",
)
READ_AT_START = ("PYTHON", "NUMBA_", "OMP_", "OPENBLAS_", "LD_", "LC_", "LANG")  # no effect after the imports
PR_SET_CHILD_SUBREAPER = 36  # prctl(2): orphans become children of this process
LARGEST_REQUEST = 1 << 17


class Popen(subprocess.Popen):
    """`subprocess.Popen` that forks `[sys.executable, "-m", "piezod", ...]` where that makes no difference."""

    def _execute_child(self, *given):
        bound = inspect.signature(subprocess.Popen._execute_child).bind(self, *given).arguments
        environment = dict(os.environ if bound["env"] is None else bound["env"])
        if not _can_fork(bound["args"], environment) or bound["preexec_fn"] or bound["pass_fds"]:
            super()._execute_child(*given)
            return
        request = {
            "arguments": [os.fspath(argument) for argument in bound["args"][2:]],
            "folder": os.fspath(bound["cwd"] or Path.cwd()),
            "environment": environment,
            "new_session": bool(bound["start_new_session"]),
        }
        files = [bound[name] for name in ("p2cread", "c2pwrite", "errwrite")]
        self.pid = _fork_server().fork(request, [n if file == -1 else file for n, file in enumerate(files)])
        self._child_created = True
        self._close_pipe_fds(*(bound[n] for n in ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")))


def run(arguments, *, timeout=None, **options):
    """`subprocess.run` of these arguments with captured text, by `Popen`."""
    with Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options) as process:
        try:
            output, errors = process.communicate(timeout=timeout)
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(arguments, process.returncode, output, errors)


def _can_fork(arguments, environment):
    """Whether the module is preloaded, and no variable differs that only a new interpreter reads."""
    here = {name: value for name, value in os.environ.items() if name.startswith(READ_AT_START)}
    there = {name: value for name, value in environment.items() if name.startswith(READ_AT_START)}
    known = list(arguments[:2]) == [sys.executable, "-m"] and len(arguments) > 2 and arguments[2] in MODULES
    return known and here == there and "PIEZOD_UNDER_TEST" not in environment


class _ForkServer:
    """The process that forks, seen from the test process."""

    def __init__(self):
        self._socket, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.benches.processes", str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=[other.fileno()],
                cwd=ROOT,
            )
        atexit.register(self.close)

    def fork(self, request, files):
        """Start a process; returns its id."""
        prctl = ctypes.CDLL(None).prctl
        prctl(PR_SET_CHILD_SUBREAPER, 1)
        try:
            socket.send_fds(self._socket, [json.dumps(request).encode()], files)
            return int(self._socket.recv(64))
        finally:
            prctl(PR_SET_CHILD_SUBREAPER, 0)

    def close(self):
        self._socket.close()
        self._process.wait()


@cache
def _fork_server():
    return _ForkServer()


def serve(connection):
    """Fork a process for each request; returns the request and its files in the forked process, None at the end."""
    for module in PRELOADED:
        importlib.import_module(module)
    gc.collect()
    gc.freeze()
    while True:
        message, files, _, _ = socket.recv_fds(connection, LARGEST_REQUEST, 3)
        if not message:
            return None
        number = _fork_orphan()
        if number == 0:
            return json.loads(message), files
        for file in files:
            os.close(file)
        connection.send(str(number).encode())


def _fork_orphan():
    """Fork a process whose parent has ended; returns 0 in it, and its id here."""
    read, write = os.pipe()
    between = os.fork()
    if between == 0:
        number = os.fork()
        if number != 0:
            os.write(write, str(number).encode())
            os._exit(0)
    os.close(write)
    if between == 0:
        os.close(read)
        return 0
    os.waitpid(between, 0)
    number = int(os.read(read, 64))
    os.close(read)
    return number


def become(request, files):
    """Make this process that of the request, and run its module to the end of the program."""
    for number, file in enumerate(files):
        os.dup2(file, number)
    for file in files:
        os.close(file)
    if request["new_session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(2, "w", encoding="utf-8", errors="backslashreplace", buffering=1, closefd=False)  # noqa: SIM115
    sys.path[0] = request["folder"]
    sys.argv = request["arguments"]
    gc.enable()
    runpy.run_module(request["arguments"][0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    with socket.socket(fileno=int(sys.argv[1])) as to_tests:
        wanted = serve(to_tests)
    if wanted is not None:
        become(*wanted)
