"""Faults that stand between the daemon and its device before anything is driven."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import textwrap
import time

import numpy as np
import yaml

from piezod.config import load_bench
from piezod.errors import PiezodError
from piezod.transport import make_link
from tests.faults.at_work import Watch, do
from tests.faults.live import LiveBench, Service, Stage
from tests.faults.stand import CannotBeDoneHereError, Seen, apart

NETWORK = "10.213.77"  # of the veth pair; in no routing table but this machine's, and only while the fault lasts


@contextlib.contextmanager
def _bench_of(stand, stage=None, changes=None, prefix=()):
    bench = LiveBench(stand.new_folder(), stage, changes, prefix)
    try:
        yield bench
    finally:
        bench.close()


@contextlib.contextmanager
def _door(kind):
    """A port where nobody listens, or where nothing is ever answered; host and port."""
    with socket.socket() as listener, contextlib.ExitStack() as stack:
        listener.bind(("127.0.0.1", 0))
        address = listener.getsockname()
        if kind == "blackhole":  # a full backlog: further SYNs are dropped without a word
            listener.listen(0)
            for _ in range(8):
                filler = stack.enter_context(socket.socket())
                filler.setblocking(False)
                filler.connect_ex(address)
            time.sleep(0.1)
        else:
            listener.close()
        yield address


def unreachable(stand, fault, *, door, host=None):
    """Start the service on a device that is not there; READY and its status, then how long one attempt takes."""
    bench = stand.bench()
    with _door(door) as (address, port):
        content = yaml.safe_load(bench.path.read_text(encoding="utf-8"))
        folder = stand.new_folder()
        content["link"] |= {"host": host or address, "port": port}
        content["daemon"] = {"ring_log": str(folder / "ring")}
        path = folder / "bench.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        service = Service(path)
        try:
            ready_s = service.wait_told("READY=1")
            service.wait_told("STATUS=DISARMED, link")
            seen = Seen(text=service.log() + "\n" + service.status_lines())
            seen.state = "DISARMED" if "STATUS=DISARMED" in seen.text else ""
            seen.after_ms = 1e3 * ((ready_s or 1e9) - service.begun_s)
            seen.figures["exit_code_of_the_service"] = service.end()
        finally:
            service.close()
        begun_s = time.monotonic()
        with contextlib.suppress(PiezodError):
            make_link(load_bench(path).link).open()
        seen.figures["attempt_ms"] = 1e3 * (time.monotonic() - begun_s)
        seen.exit_code, text, _ = apart("run", path, "--arm")
        seen.text += text
    return seen


def refused_at_start(stand, fault, *, wire="tcp", steps=(), old=None, new=None, arguments=("--arm",)):
    """Start on a device that is there, but not as it should be."""
    bench = stand.bench(wire)
    with _without_daemon(bench):
        path = bench.path
        if old is not None:
            text = path.read_text(encoding="utf-8")
            assert old in text, old
            path = stand.new_folder() / "bench.yaml"
            path.write_text(text.replace(old, new, 1), encoding="utf-8")
        for step in steps:
            do(bench, step)
        bench.stage.ask("mark")
        code, text, after_ms = apart("run", path, *arguments)
        report = bench.stage.ask("report")
        seen = Seen("DISARMED", code, text, after_ms, wrong=report["wrong"])
        seen.figures = {"highest_V": report["highest_V"], "commands": report["commands"]}
    bench.heal()
    return seen


@contextlib.contextmanager
def _without_daemon(bench):
    """Its daemon ended, for as long as another drives the bench."""
    if bench.service is not None and bench.service.alive:
        bench.service.end()
    bench.drop()
    yield


def one_client_only(stand, fault):
    """Somebody else is connected to a device that serves one client."""
    with _bench_of(stand, {"one_client": True}) as bench:
        host, _, port = bench.stage.serves["direct"].rpartition(":")
        text = bench.path.read_text(encoding="utf-8").replace(bench.stage.serves["tcp"].rpartition(":")[2], port, 1)
        bench.path.write_text(text, encoding="utf-8")
        with socket.create_connection((host, int(port))):
            time.sleep(0.1)
            code, said, after_ms = apart("run", bench.path, "--arm")
    return Seen("DISARMED", code, said, after_ms)


def port_taken(stand, fault):
    """Another process has the serial port."""
    bench = stand.bench("rtu")
    with _without_daemon(bench):
        program = "import serial,sys; p=serial.Serial(sys.argv[1], exclusive=True); print('held', flush=True); "
        program += "sys.stdin.read()"
        holder = subprocess.Popen(
            [sys.executable, "-c", program, bench.stage.serves["rtu"]],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        with holder:
            holder.stdout.readline()
            code, text, after_ms = apart("run", bench.path, "--arm")
            holder.stdin.close()
        seen = Seen("DISARMED", code, text, after_ms)
        ends = (holder.pid, bench.stage.process.pid)  # the cable's own end holds it open too
        seen.figures["names_the_holder"] = float(any(f"process {pid} " in text for pid in ends))
    bench.heal()
    return seen


def cable(stand, fault):
    """A pair of virtual cables into a network namespace with the device; one end goes down while it runs."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        raise CannotBeDoneHereError("needs root and ip")
    name = f"pz{os.getpid() % 100000}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode != 0:
        raise CannotBeDoneHereError(f"no network namespaces here: {made.stderr.strip()[:80]}")
    try:
        _run("ip", "link", "add", f"{name}a", "type", "veth", "peer", "name", f"{name}b", "netns", name)
        _run("ip", "addr", "add", f"{NETWORK}.1/30", "dev", f"{name}a")
        _run("ip", "link", "set", f"{name}a", "up")
        _run("ip", "-n", name, "addr", "add", f"{NETWORK}.2/30", "dev", f"{name}b")
        _run("ip", "-n", name, "link", "set", f"{name}b", "up")
        _run("ip", "-n", name, "link", "set", "lo", "up")
        return _pulled(stand, fault, name)
    finally:
        subprocess.run(["ip", "link", "del", f"{name}a"], capture_output=True, check=False)
        _run("ip", "netns", "del", name)


def _pulled(stand, fault, name):
    slow = {"timeout_s": 0.05}  # ten ticks: the loss must be told when it is due, not when the timeout is over
    changes = {"link": {"allow_plaintext_remote": True} | slow, "limits": {"missed_ticks_in_a_row": 100}}
    with _bench_of(stand, {"host": f"{NETWORK}.2"}, changes, ("ip", "netns", "exec", name)) as bench:
        bench.heal()
        bench.arm()
        watch, seen = Watch(bench), Seen()
        _run("ip", "-n", name, "link", "set", f"{name}b", "down")
        watch.until(fault.expect.states, 0.5, fault.within_ms)
        watch.tell(seen)
        _run("ip", "-n", name, "link", "set", f"{name}b", "up")
        bench.heal()
        seen.armings = bench.rearms
    return seen


def _run(*arguments):
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise CannotBeDoneHereError(f"{' '.join(arguments)}: {done.stderr.strip()[:80]}")


CLOCK_THAT_JUMPS = """
    #define _GNU_SOURCE
    #include <time.h>
    #include <sys/syscall.h>
    #include <unistd.h>
    int clock_gettime(clockid_t id, struct timespec *now)
    {
        struct timespec up;
        int failed = syscall(SYS_clock_gettime, id, now);
        if (!failed && id == CLOCK_REALTIME) {
            syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &up);
            now->tv_sec += up.tv_nsec / 250000000 % 2 ? 3600 : -3600;
        }
        return failed;
    }
"""


def wall_clock(stand, fault, *, for_s=2.0):
    """A daemon whose wall clock jumps by two hours four times a second."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise CannotBeDoneHereError("no C compiler to build the clock with")
    folder = stand.new_folder()
    (folder / "clock.c").write_text(textwrap.dedent(CLOCK_THAT_JUMPS), encoding="ascii")
    library = folder / "clock.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, folder / "clock.c"], check=True)
    environment = os.environ | {"LD_PRELOAD": str(library)}
    program = "import time; e=time.monotonic()+.6; t=[]\nwhile time.monotonic()<e: t.append(time.time())\n"
    program += "print(max(t)-min(t))"
    jumped = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
    )
    with _bench_of(stand) as bench:
        bench.environment = {"LD_PRELOAD": str(library)}
        bench.heal()
        bench.arm()
        watch, seen = Watch(bench), Seen()
        watch.until(fault.expect.states, for_s, fault.within_ms)
        watch.tell(seen)
        rows = np.concatenate(watch.parts)
        seen.figures["clock_jumped_s"] = float(jumped.stdout)
        seen.figures["lasted_s"] = float(rows["time_ns"][-1] - rows["time_ns"][0]) * 1e-9
        bench.heal()
        seen.armings = bench.rearms
    return seen


def skewed_device(stand, fault, *, for_s=1.5):
    """A device whose clock runs at another rate than ours."""
    with _bench_of(stand, {"effects": ["clock_skew"]}) as bench:
        bench.heal()
        bench.arm()
        watch, seen = Watch(bench), Seen()
        watch.until(fault.expect.states, for_s, fault.within_ms)
        watch.tell(seen)
        bench.heal()
        seen.armings = bench.rearms
    return seen


def moved_name(stand, fault):
    """The device's name stands for another address than when it was last connected."""
    first, second = Stage({}), Stage({"host": "127.0.0.2"})
    real = socket.getaddrinfo
    bench = stand.bench()
    try:
        link_config = load_bench(bench.path).link
        where = {"now": first.serves["direct"]}

        def resolve(_host, _port, **_):
            host, _, port = where["now"].rpartition(":")
            return real(host, int(port), type=socket.SOCK_STREAM)

        socket.getaddrinfo = resolve
        link = make_link(link_config.model_copy(update={"host": "127.0.0.1"}))
        link.open()
        good_before = link.poll() == 0
        where["now"] = second.serves["direct"]
        first.close()
        lost = link.poll() != 0
        begun_s = time.monotonic()
        link.open()
        good_after = link.poll() == 0
        link.close()
    finally:
        socket.getaddrinfo = real
        second.close()
    seen = Seen("DISARMED", after_ms=1e3 * (time.monotonic() - begun_s))
    seen.figures = {"good_before": good_before, "lost": lost, "good_after": good_after}
    return seen


INJECTORS = {
    "unreachable": unreachable,
    "refused_at_start": refused_at_start,
    "one_client_only": one_client_only,
    "port_taken": port_taken,
    "cable": cable,
    "wall_clock": wall_clock,
    "skewed_device": skewed_device,
    "moved_name": moved_name,
}
