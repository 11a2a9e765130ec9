"""`piezod run` as systemd would start it: with a socket that hears what it tells, and commands as a user gives them."""

import contextlib
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from piezod.daemon.client import command_and_wait
from piezod.errors import CheckFailedError
from tests.benches.emulator import piezod
from tests.benches.processes import Popen

PATIENT = {"comm_loss_ms": 2000, "device_watchdog_ms": 1000, "missed_ticks_in_a_row": 500}
LONG_LIMITS = {"comm_loss_ms": 9000, "device_watchdog_ms": 8000, "stale_after_ms": 4000, "missed_ticks_in_a_row": 2000}
"""Limits that no busy machine exceeds."""
WITHIN_S = 120.0  # of a service that hangs; a test waits for what happens, however busy the machine is


def until(condition):
    """Wait until something is so."""
    deadline_s = time.monotonic() + WITHIN_S
    while not condition():
        assert time.monotonic() < deadline_s, "it did not happen in time"
        time.sleep(0.05)


class Daemon:
    """One running service.

    `told` is what it told systemd, with times; `said` what it wrote to the log.
    """

    def __init__(self, bench, *arguments):
        self.bench, self.ring = bench, bench.parent / "ring"
        self.told, self.said = [], []
        self.begun_s = time.monotonic()
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        name = f"\0piezod-tests-{os.getpid()}-{id(self)}"
        self.listener.bind(name)
        self.process = Popen(
            [sys.executable, "-m", "piezod", "run", str(bench), *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"NOTIFY_SOCKET": "@" + name[1:]},
        )
        self.threads = [threading.Thread(target=self.listen), threading.Thread(target=self.read)]
        for thread in self.threads:
            thread.start()

    def listen(self):
        while data := self.listener.recv(4096):
            self.told += [(time.monotonic() - self.begun_s, line) for line in data.decode().splitlines()]

    def read(self):
        for line in self.process.stderr:
            self.said.append(line)

    def wait_until(self, condition, what):
        deadline_s = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < deadline_s, f"{what} did not happen: {self.said} {self.told[-5:]}"
            assert self.process.poll() is None or condition(), f"it ended before {what}: {self.said}"
            time.sleep(0.01)

    def has_told(self, word):
        return any(word in line for _, line in self.told)

    def ready(self):
        self.wait_until(lambda: self.has_told("READY=1"), "READY=1")
        return next(s for s, line in self.told if line == "READY=1")

    def connected(self):
        self.wait_until(lambda: any("reading only" in line for line in self.said), "connecting")
        return self

    def wait_for(self, word):
        self.wait_until(lambda: any(word in line for line in self.said), word)

    def command(self, name, *options):
        """A command as a user gives it."""
        return piezod(name, self.bench, *options)

    def tell(self, name, *, wait=True):
        """A command without the seconds that a new interpreter takes."""
        return command_and_wait(Path(f"{self.ring}.sock"), name, wait=wait)

    def refuses(self, name, says, error=CheckFailedError):
        with pytest.raises(error, match=re.escape(says)):
            self.tell(name)

    def status(self):
        return self.tell("status")

    def signal(self, number):
        os.kill(self.process.pid, number)

    def control_pid(self):
        """The process that this one started and that drives: the one that is not a resource tracker."""
        children = subprocess.run(
            ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(self.process.pid)],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.splitlines()
        return next(int(line.split()[0]) for line in children if "spawn_main" in line)

    def end(self):
        """SIGTERM, and the exit code."""
        self.signal(signal.SIGTERM)
        return self.process.wait(timeout=WITHIN_S)

    def close(self):
        if self.process.poll() is None:
            self.process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(timeout=WITHIN_S)
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.listener.shutdown(socket.SHUT_RD)
        for thread in self.threads:
            thread.join()
        self.listener.close()
        self.process.stderr.close()


@contextlib.contextmanager
def daemon(bench, *arguments):
    """A service, ended by its id whatever happens."""
    running = Daemon(bench, *arguments)
    try:
        yield running
    finally:
        running.close()


def client(serves):
    """A client of the emulated device beside the daemon."""
    host, _, port = serves["tcp"].rpartition(":")
    return ModbusTcpClient(host, port=int(port), timeout=2)


def register(serves, address):
    """One float of the emulated device."""
    with client(serves) as modbus:
        words = modbus.read_holding_registers(address, count=2, device_id=1).registers
    return struct.unpack(">f", struct.pack(">2H", *words))[0]


def change(bench, old, new):
    """Edit a bench file in place."""
    text = bench.read_text(encoding="utf-8")
    assert old in text, old
    bench.write_text(text.replace(old, new, 1), encoding="utf-8")
