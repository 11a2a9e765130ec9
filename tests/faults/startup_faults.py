"""Faults of address, port, cable and clock: the daemon cannot reach its device, or both disagree about time."""

import contextlib
import os
import shutil
import socket
import subprocess
import time

import yaml

from piezod.config import load_bench
from piezod.errors import PiezodError
from piezod.runtime import sockets
from piezod.transport import make_link
from tests.faults.bench_pool import InjectionUnavailableError, Observation, run_piezod
from tests.faults.live_bench import DeviceProcess, LiveBench, Service
from tests.faults.running_faults import Watch

NETWORK = "10.213.77"  # addresses of the veth pair, which exists only during the fault


@contextlib.contextmanager
def _own_bench(pool, device_settings=None, changes=None, prefix=()):
    bench = LiveBench(pool.new_folder(), device_settings, changes, prefix)
    try:
        yield bench
    finally:
        bench.close()


@contextlib.contextmanager
def _silent_port(kind):
    """Address of a closed port, or (`blackhole`) of a port that never answers: (host, port)."""
    with socket.socket() as listener, contextlib.ExitStack() as stack:
        listener.bind(("127.0.0.1", 0))
        address = listener.getsockname()
        if kind == "blackhole":  # a full backlog: further SYNs are dropped without an answer
            listener.listen(0)
            for _ in range(8):
                filler = stack.enter_context(socket.socket())
                filler.setblocking(False)
                filler.connect_ex(address)
            time.sleep(0.1)
        else:
            listener.close()
        yield address


def unreachable(pool, fault, *, door, host=None):
    """Start the service without a device: READY, status, duration of one attempt, and exit code with --arm."""
    bench = pool.bench()
    with _silent_port(door) as (address, port):
        content = yaml.safe_load(bench.path.read_text(encoding="utf-8"))
        folder = pool.new_folder()
        content["link"] |= {"host": host or address, "port": port}
        content["daemon"] = {"ring_log": str(folder / "ring")}
        path = folder / "bench.yaml"
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        service = Service(path)
        try:
            ready_s = service.wait_notification("READY=1")
            service.wait_notification("STATUS=DISARMED, link")
            observed = Observation(text=service.log() + "\n" + service.status_lines())
            observed.state = "DISARMED" if "STATUS=DISARMED" in observed.text else ""
            observed.after_ms = 1e3 * ((ready_s or 1e9) - service.begun_s)
            observed.figures["exit_code_of_the_service"] = service.end()
        finally:
            service.close()
        begun_s = time.monotonic()
        with contextlib.suppress(PiezodError):
            make_link(load_bench(path).link).open()
        observed.figures["attempt_ms"] = 1e3 * (time.monotonic() - begun_s)
        observed.exit_code, text, _ = run_piezod("run", path, "--arm")
        observed.text += text
    return observed


def cable(pool, fault):
    """Run the device in a network namespace behind a veth pair, and set one end down while the bench drives."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        raise InjectionUnavailableError("needs root and ip")
    name = f"pz{os.getpid() % 100000}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode != 0:
        raise InjectionUnavailableError(f"no network namespaces here: {made.stderr.strip()[:80]}")
    try:
        _run("ip", "link", "add", f"{name}a", "type", "veth", "peer", "name", f"{name}b", "netns", name)
        _run("ip", "addr", "add", f"{NETWORK}.1/30", "dev", f"{name}a")
        _run("ip", "link", "set", f"{name}a", "up")
        _run("ip", "-n", name, "addr", "add", f"{NETWORK}.2/30", "dev", f"{name}b")
        _run("ip", "-n", name, "link", "set", f"{name}b", "up")
        _run("ip", "-n", name, "link", "set", "lo", "up")
        return _set_link_down(pool, fault, name)
    finally:
        subprocess.run(["ip", "link", "del", f"{name}a"], capture_output=True, check=False)
        _run("ip", "netns", "del", name)


def _set_link_down(pool, fault, name):
    slow = {"timeout_s": 0.05}  # ten ticks: the loss must be detected at its limit, not at the end of the timeout
    changes = {"link": {"allow_plaintext_remote": True} | slow, "limits": {"missed_ticks_in_a_row": 100}}
    with _own_bench(pool, {"host": f"{NETWORK}.2"}, changes, ("ip", "netns", "exec", name)) as bench:
        bench.restore()
        bench.arm()
        watch, observed = Watch(bench), Observation()
        _run("ip", "-n", name, "link", "set", f"{name}b", "down")
        watch.until(fault.expect.states, 0.5, fault.within_ms)
        watch.finish(observed)
        _run("ip", "-n", name, "link", "set", f"{name}b", "up")
        bench.restore()
        observed.armings = bench.rearms
    return observed


def _run(*arguments):
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InjectionUnavailableError(f"{' '.join(arguments)}: {done.stderr.strip()[:80]}")


def _answers_within(link, seconds):
    """Poll as the loop does, which stands a single late reply, and return whether one was good in this time."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        if link.poll() == 0:
            return True
    return False


def moved_name(pool, fault):
    """Reconnect after the host name of the device resolves to another address."""
    first, second = DeviceProcess({}), DeviceProcess({"host": "127.0.0.2"})
    real = sockets.getaddrinfo
    bench = pool.bench()
    try:
        link_config = load_bench(bench.path).link
        where = {"now": first.serves["direct"]}

        def resolve(_host, _port, **_):
            host, _, port = where["now"].rpartition(":")
            return real(host, int(port), type=socket.SOCK_STREAM)

        sockets.getaddrinfo = resolve
        link = make_link(link_config.model_copy(update={"host": "127.0.0.1"}))
        link.open()
        good_before = _answers_within(link, 1.0)
        where["now"] = second.serves["direct"]
        first.close()
        lost = link.poll() != 0
        begun_s = time.monotonic()
        link.open()
        good_after = _answers_within(link, 1.0)
        link.close()
    finally:
        sockets.getaddrinfo = real
        second.close()
    observed = Observation("DISARMED", after_ms=1e3 * (time.monotonic() - begun_s))
    observed.figures = {"good_before": good_before, "lost": lost, "good_after": good_after}
    return observed


INJECTORS = {
    "unreachable": unreachable,
    "cable": cable,
    "moved_name": moved_name,
}
