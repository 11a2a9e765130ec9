"""Rows of the fault list that are a course of actions: each function is one, run by a thread of the operator."""

import contextlib
import hmac
import os
import signal
import struct

from piezod.config import load_bench
from piezod.daemon.client import Client, command_and_wait
from piezod.daemon.run import run_foreground
from piezod.errors import PiezodError, TemporaryError
from piezod.transport import make_link
from tests.simulation import amplifier as judged
from tests.simulation.machine import BOOTED_NS, Process, Thread

POLL_S = 0.02
STREAMED_N = 100.0
KEY = bytes(range(32))  # shared by the bench and the sender of a stream
REST_MARGIN_S = 0.5  # beside the time of the ramp
JUDGED_AFTER_S = 4.0
STAYS_S = 0.5  # at rest, before the blockade ends
SILENT = 300  # clients: more than both sockets serve
MESSAGES = 200


def told(history, command):
    """Send a command, and keep the exit code and the text of its answer."""
    history.client_code = 0
    if command == "arm":
        history.arm_begins()
    try:
        client = Client(history.folder / "ring.sock")
        try:
            return client.ask(command)
        finally:
            client.close()
            history.arm_ends(command)
    except PiezodError as error:
        history.client_code = error.exit_code
        history.answers.append((history.machine.time_s, command, str(error)))
        raise


def wait(history, condition, within_s=20.0):
    end_ns = history.machine.now_ns + round(1e9 * within_s)
    while not condition() and history.machine.now_ns < end_ns:
        history.machine.sleep(POLL_S)


def arm(history, **_):
    with contextlib.suppress(PiezodError):
        told(history, "arm")


def reset(history, **_):
    with contextlib.suppress(PiezodError):
        told(history, "reset")


def reload_while_starting(history, old, first, second, **_):
    """Reload twice; the second time while the control process starts with the configuration of the first."""
    history.write_edited(old, first)
    told(history, "reload")
    wait(history, lambda: not told(history, "status")["connected"])
    history.write_edited(old, second)
    for _ in range(200):
        try:
            told(history, "reload")
            break
        except TemporaryError:
            history.machine.sleep(POLL_S)
    wait(history, lambda: told(history, "status")["connected"])
    history.machine.sleep(0.2)
    history.mark_fault()
    told(history, "arm")


def tighten_while_driving(history, key, from_, step, every_s, for_s, **_):
    """Tighten the limit `key` by `step` every `every_s` while the reference is followed."""
    told(history, "arm")
    history.mark_fault()
    wait(history, lambda: told(history, "status")["state"] == "RUNNING")
    value, end_ns = from_, history.machine.now_ns + round(1e9 * for_s)
    while history.machine.now_ns < end_ns and told(history, "status")["state"] == "RUNNING":
        value -= step
        history.write_edited(f"{key}: {from_}", f"{key}: {value}")
        with contextlib.suppress(PiezodError):  # the state may have changed since
            told(history, "reload")
            history.counted["reloads"] += 1
        history.machine.sleep(every_s)


def reload_between_two_drives(history, old, new, drive_s, **_):
    """Drive, disarm, reload, and drive again: the stack is still warm."""
    told(history, "arm")
    history.mark_fault()
    history.machine.sleep(drive_s)
    told(history, "disarm")
    wait(history, lambda: told(history, "status")["state"] == "DISARMED")
    history.write_edited(old, new)
    told(history, "reload")
    wait(history, lambda: not told(history, "status")["connected"])
    wait(history, lambda: told(history, "status")["connected"])
    history.machine.sleep(0.2)
    history.mark_fault()
    told(history, "arm")


def arm_with_late_replies(history, late_s, clear_after_s, **_):
    """Arm while every reply is late; the replies are prompt again after the daemon has reported a failure."""
    history.mark_fault()
    history.do_rules([{"do": "delay", "by": late_s, "count": 0}])
    begun_ns = history.machine.now_ns
    code = 0
    try:
        told(history, "arm")
    except PiezodError as error:
        code = error.exit_code
    history.machine.sleep(max(0.0, clear_after_s - 1e-9 * (history.machine.now_ns - begun_ns)))
    history.network.rules.clear()
    history.client_code = code


def ask_for_rail(history, **_):
    history.counted["railed"] = float(told(history, "status").get("rail", {}).get("railed", False))


def send_hostile_lines(history, lines, longest, **_):
    """Malformed, endless and incomplete messages."""
    path = str(history.folder / "ring.sock")
    slow = history.kernel.socket(1, 1)
    slow.connect(path)
    with contextlib.suppress(OSError):
        for _ in range(longest // 100):
            slow.sendall(b"{" * 100)
    slow.close()
    for line in lines:
        client = history.kernel.socket(1, 1)
        client.settimeout(3.0)
        with contextlib.suppress(OSError):
            client.connect(path)
            client.sendall(line.encode("latin-1") + b"\n")
            history.counted["refused"] += b'"ok": false' in client.recv(4096)
        client.close()


def crowd(history, command, polite=0, idle=0, crowd_s=1.0, **_):
    """Send a command while clients ask for the status, or are merely connected."""
    machine, ended = history.machine, []
    path = history.folder / "ring.sock"

    def ask_politely():
        while not ended:
            client = history.kernel.socket(1, 1)
            client.settimeout(2.0)
            with contextlib.suppress(OSError):
                client.connect(str(path))
                while not ended:
                    machine.sleep(0.1)
                    client.sendall(b'{"command": "status"}\n')
                    if not client.recv(65536):
                        break
            client.close()
            machine.sleep(POLL_S)

    for _ in range(polite):
        Thread(history.operator, ask_politely, "polite")
    if idle:
        Thread(history.operator, lambda: _stay_connected(history, str(path), idle, ended), "idle")
    machine.sleep(crowd_s)
    history.mark_fault()
    begun_ns = machine.now_ns
    history.client_code = 0
    try:
        command_and_wait(path, command, wait=True)
    except PiezodError as error:
        history.client_code = error.exit_code
        history.answers.append((machine.time_s, command, str(error)))
    history.counted["command_ms"] = 1e-6 * (machine.now_ns - begun_ns)
    ended.append(True)


def _stay_connected(history, path, count, ended):
    clients = []
    while not ended:
        while len(clients) < count:
            client = history.kernel.socket(1, 1)
            client.setblocking(False)
            try:
                client.connect(path)
            except OSError:
                client.close()
                break
            clients.append(client)
        for client in clients[:]:
            try:
                closed = not client.recv(65536)
            except BlockingIOError:
                closed = False
            except OSError:
                closed = True
            if closed:
                client.close()
                clients.remove(client)
        history.machine.sleep(0.01)
    for client in clients:
        client.close()


def forge_stream(history, **_):
    """Forge, alter and repeat datagrams of a stream with a shared key, while its sender goes on."""
    machine, ended, number = history.machine, [], [0]

    def signed(value_N, session, key):
        number[0] += 1
        body = struct.pack("<QQQd", session, number[0], machine.now_ns + machine.wall_offset_ns, value_N)
        body += hmac.new(key, body, "sha256").digest()[:16]
        history._deliver(body)
        return body

    def send_on():
        while not ended:
            signed(STREAMED_N, 5, KEY)
            machine.sleep(0.01)

    recorded = [signed(200.0, 5, KEY) for _ in range(5)]
    Thread(history.operator, send_on, "sender")
    machine.sleep(0.2)
    told(history, "arm")
    wait(history, lambda: told(history, "status")["state"] == "RUNNING")
    machine.sleep(0.5)
    history.mark_fault()
    altered = [one[:32] + machine.random.randbytes(16) for one in recorded]
    for body in [*recorded, *altered, *(one[:32] for one in recorded)]:
        history._deliver(body)
        before = number[0]
        signed(200.0, 9, bytes(32))
        number[0] = before
        machine.sleep(0.01)
    history._deliver(struct.pack("<QQd", 10**6, machine.now_ns + machine.wall_offset_ns, 200.0))
    machine.sleep(0.5)
    values = told(history, "status").get("reference_values") or {}
    history.counted["refused"] = sum(count for name, count in values.items() if name != "accepted")
    history.observe()
    ended.append(True)


def stop_while_blocked(history, blockade, way):
    """Apply a blockade while driving, stop, and look whether the output is at rest in time."""
    machine, service = history.machine, history.service
    told(history, "arm")
    wait(history, lambda: told(history, "status")["state"] == "RUNNING")
    machine.sleep(0.3)
    history.mark_fault()
    unblock = BLOCKADES[blockade](history)
    history.amplifier.catch_up()
    from_V, begun_ns = history.amplifier.bench.output_V, machine.now_ns
    if way == "SIGTERM":
        service.signal(signal.SIGTERM)
    else:
        Thread(history.operator, lambda: _quietly(history, way), way)
    wait(history, lambda: _rest_step(history) >= 0, JUDGED_AFTER_S)
    machine.sleep(STAYS_S)
    rest_step = _rest_step(history)
    rest_ns = BOOTED_NS + round(1e9 * history.amplifier.time_of(rest_step)) if rest_step >= 0 else 1 << 62
    took_s, limits = 1e-9 * (rest_ns - begun_ns), load_bench(history.driven_path).limits
    per_s = limits.slew_V_per_s if way == "stop" else limits.ramp_down_V_per_s
    history.counted["stops"] += 1
    history.counted["late"] += took_s > from_V / per_s + REST_MARGIN_S
    history.counted["took_ms"] = 1e3 * took_s
    unblock()


def _rest_step(history):
    """Step of the physics at which the output came to rest; negative while it is not at rest."""
    history.amplifier.catch_up()
    return history.amplifier.judge[judged.REST_STEP]


def _quietly(history, command):
    with contextlib.suppress(PiezodError):
        command_and_wait(history.folder / "ring.sock", command, wait=False)


def _send(history, lines):
    client = history.kernel.socket(1, 1)
    client.settimeout(1.0)
    with contextlib.suppress(OSError):
        client.connect(str(history.folder / "ring.sock"))
        client.sendall(lines)
    return client


def _log(history, how):
    for process in (history.service, history.control):
        process.log_fault = how
    for _ in range(MESSAGES):
        _send(history, b"x" * 5000).close()
    return lambda: [setattr(one, "log_fault", "") for one in history.machine.processes]


def _reload(history):
    client = _send(history, b'{"command": "reload"}\n')
    history.machine.sleep(0.5)
    return client.close


def _bench_pipe(history):
    history.path.unlink()
    os.mkfifo(history.path)
    return _reload(history)


def _bench_device(history):
    history.path.unlink()
    history.path.symlink_to("/dev/zero")
    return _reload(history)


def _model_pipe(history):
    model = history.folder / "model.yaml"
    model.unlink()
    os.mkfifo(model)
    return _reload(history)


def _huge_reference(history):
    with (history.folder / "huge.csv").open("wb") as file:
        file.write(b"time_s,reference_N\n0,1\n")
        file.truncate(3 << 30)
    history.write_section("reference", {"kind": "file", "path": "huge.csv"})
    return _reload(history)


def _many_reloads(history):
    clients = [_send(history, b'{"command": "reload"}\n' * 200) for _ in range(11)]
    history.machine.sleep(0.5)
    return lambda: [one.close() for one in clients]


def _short_connections(history):
    ended = []

    def storm(path):
        while not ended:
            client = history.kernel.socket(1, 1)
            client.settimeout(0.5)
            with contextlib.suppress(OSError):
                client.connect(path)
            client.close()
            history.machine.sleep(2e-4)  # the time that a connection takes

    for name in ("ring.sock", "ring.sock", "ring.sock.stop"):
        Thread(history.operator, lambda name=name: storm(str(history.folder / name)), "storm")
    history.machine.sleep(0.5)
    return lambda: ended.append(True)


def _silent_clients(history):
    clients = []
    for number in range(SILENT):
        client = history.kernel.socket(1, 1)
        client.setblocking(False)
        with contextlib.suppress(OSError):
            client.connect(str(history.folder / ("ring.sock.stop" if number % 2 else "ring.sock")))
        clients.append(client)
    return lambda: [client.close() for client in clients]


def _signal_storm(history):
    ended, service = [], history.service

    def storm():
        while not ended and service.alive:
            service.signal(signal.SIGHUP)
            history.machine.sleep(1 / 300)

    Thread(history.operator, storm, "storm")
    history.machine.sleep(0.5)
    return lambda: ended.append(True)


BLOCKADES = {
    "log_stands": lambda history: _log(history, "stands"),
    "log_gone": lambda history: _log(history, "gone"),
    "bench_pipe": _bench_pipe,
    "bench_device": _bench_device,
    "model_pipe": _model_pipe,
    "huge_reference": _huge_reference,
    "many_reloads": _many_reloads,
    "short_connections": _short_connections,
    "silent_clients": _silent_clients,
    "signal_storm": _signal_storm,
}


def start_beside(history, **sections):
    """Start a second service; with sections, from a bench file of its own."""
    path = history.path
    if sections:
        path = history.folder / "second.yaml"
        path.write_text(history.with_sections(sections), encoding="utf-8")
    begun_ns = history.machine.now_ns
    process = Process(history.machine, "second daemon")

    def run():
        try:
            history.client_code = run_foreground(path, arm=False).exit_code
        except PiezodError as error:
            history.client_code = error.exit_code
            history.answers.append((history.machine.time_s, "run", str(error)))
            history.counted["names_the_holder"] = float(f"process {history.service.pid}" in str(error))
        history.counted["after_ms"] = 1e-6 * (history.machine.now_ns - begun_ns)

    process.start(run)


def try_to_connect(history, **_):
    """The time of one attempt to open the link."""
    begun_ns = history.machine.now_ns
    with contextlib.suppress(PiezodError):
        make_link(load_bench(history.path).link).open()
    history.counted["attempt_ms"] = 1e-6 * (history.machine.now_ns - begun_ns)


def connect_all_the_time(history, **_):
    clients = []
    while history.alive:
        client = history.kernel.socket(1, 1)
        client.setblocking(False)
        with contextlib.suppress(OSError):
            client.connect(str(history.folder / "ring.sock"))
        clients.append(client)
        if len(clients) > 12:
            clients.pop(0).close()
        history.machine.sleep(5e-4)


def hang(history, **_):
    """Stop the control process, count the notifications to systemd, then end both processes."""
    machine, control = history.machine, history.control
    history.counted["fed_before"] = history.notified.count("WATCHDOG=1")
    history.mark_fault()
    control.signal(signal.SIGSTOP)
    machine.sleep(0.4)  # the parent polls at 10 Hz and can still send one notification
    before = history.notified.count("WATCHDOG=1")
    machine.sleep(1.0)
    history.counted["fed_while_hung"] = history.notified.count("WATCHDOG=1") - before
    history.kill_all()


SCRIPTS = {
    function.__name__: function
    for function in (
        arm, reset, reload_while_starting, tighten_while_driving, reload_between_two_drives, arm_with_late_replies,
        ask_for_rail, send_hostile_lines, crowd, forge_stream, stop_while_blocked, start_beside, try_to_connect,
        connect_all_the_time, hang,
    )
}  # fmt: skip
