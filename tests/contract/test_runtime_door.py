"""The rooms of the service reach the operating system through `piezod/runtime/` only."""

import ast
from pathlib import Path

import piezod

ROOT = Path(piezod.__file__).parent
ROOMS = ("control", "transport", "session", "recorder", "daemon", "bridge")
FORBIDDEN = {
    "time": {"monotonic", "monotonic_ns", "time", "time_ns", "sleep", "perf_counter", "perf_counter_ns",
             "process_time", "clock_gettime", "clock_gettime_ns"},
    "socket": {"socket", "socketpair", "getaddrinfo", "create_connection", "create_server", "gethostbyname"},
    "select": {"select", "poll", "epoll"},
    "selectors": {"DefaultSelector", "PollSelector", "EpollSelector", "SelectSelector"},
    "signal": {"signal", "pidfd_send_signal", "raise_signal", "setitimer", "alarm", "pthread_kill"},
    "os": {"open", "close", "read", "readv", "write", "pread", "pwrite", "fsync", "fdatasync", "ftruncate", "pipe",
           "kill", "getpid", "getppid", "fork", "pidfd_open", "urandom", "set_blocking"},
    "multiprocessing": {"get_context", "Process", "Pipe", "Queue", "parent_process"},
    "subprocess": {"run", "Popen", "check_output", "check_call", "call"},
    "threading": {"Thread", "Condition", "Timer"},
    "secrets": {"randbelow", "token_hex", "token_bytes"},
    "random": {"random", "randint", "choice", "uniform"},
    "uuid": {"uuid1", "uuid4"},
    "fcntl": {"flock", "lockf"},
    "sqlite3": {"connect"},
    "serial": {"Serial"},
    "datetime": {"now", "utcnow", "today"},
    "asyncio": {"create_subprocess_exec", "create_subprocess_shell"},
}  # fmt: skip
WRITING = {"write_text", "write_bytes"}
EXCEPTIONS = {
    "control/realtime.py": "rights of a process (scheduler, memory, latency), which virtual time does not have",
}
"""Files that call the outside directly, with the reason. The list may only become shorter."""


def direct_calls(path):
    """Names of the outside that a file uses without the door, with their lines."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom):
            hidden = [name.name for name in node.names if name.name in FORBIDDEN.get(node.module or "", ())]
        elif isinstance(node, ast.Import):
            hidden = [name.name for name in node.names if name.name in FORBIDDEN and name.asname]
        elif isinstance(node, ast.Call):
            hidden = [text] if (text := _called(node)) else []
        else:
            continue
        yield from (f"line {node.lineno}: {name}" for name in hidden)


def _called(call):
    """Name of the outside that a call reaches; empty for others."""
    if _opens_for_writing(call):
        return "open for writing"
    if not isinstance(call.func, ast.Attribute):
        return ""
    name, owner = call.func.attr, call.func.value
    if name in WRITING or (isinstance(owner, ast.Name) and name in FORBIDDEN.get(owner.id, ())):
        return f"{ast.unparse(owner)}.{name}"
    return ""


def _opens_for_writing(call):
    name = call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")
    if name != "open":
        return False
    modes = [arg.value for arg in call.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)]
    modes += [key.value.value for key in call.keywords if key.arg == "mode" and isinstance(key.value, ast.Constant)]
    return any(set(mode) <= set("rwaxbt+") and set(mode) & set("wax+") for mode in modes)


def test_no_room_of_the_service_reaches_the_system_beside_the_door():
    found = {}
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if calls := list(direct_calls(path)):
                found[name] = calls
    assert {name: calls for name, calls in found.items() if name not in EXCEPTIONS} == {}
    assert set(EXCEPTIONS) <= set(found), "a file keeps the door now: take it off the list"


def test_a_call_beside_the_door_is_seen(tmp_path):
    path = tmp_path / "room.py"
    path.write_text(
        "import os, time\nfrom time import sleep\n\ndef f(p):\n    os.kill(1, 2)\n    time.time()\n"
        "    p.open('wb')\n    p.write_text('')\n    open(p, mode='a')\n"
        "    os.getcwd()\n    time.strftime('')\n    p.open('rb')\n"
    )
    found = [int(call.removeprefix("line ").partition(":")[0]) for call in direct_calls(path)]
    assert found == [2, 5, 6, 7, 8, 9]
