"""Modbus servers (a minimal one and the emulated bench) and clients to compare with."""

import contextlib
import os
import struct
import subprocess
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from piezod.commissioning.emulator import emulator_process
from piezod.commissioning.shipped_files import shipped
from tests.benchmarks.compiled import compiled
from tests.benchmarks.rounds import Figures, percentiles
from tests.benchmarks.table import NotMeasuredError

BAUDRATE = 4_000_000  # no effect on a pty; the highest gives the shortest silence between frames
UNIT = 1
DEVICE_PRIORITY = 70  # below the control process
WRITE_AT, READ_AT, READS = 100, 200, 12  # the tick's blocks in config/bench.yaml


@dataclass(frozen=True)
class Address:
    """Address of a server: `tcp` with HOST:PORT, or `rtu` with the path of a pty."""

    kind: str
    where: str

    @property
    def host(self) -> str:
        """Of a TCP server."""
        return self.where.rpartition(":")[0]

    @property
    def port(self) -> int:
        """Of a TCP server."""
        return int(self.where.rpartition(":")[2])

    @property
    def arguments(self) -> tuple[str, str]:
        """Arguments of `modbus_client.c`."""
        return (self.host, str(self.port)) if self.kind == "tcp" else (self.where, str(BAUDRATE))


@contextlib.contextmanager
def minimal_server(kind: str) -> Iterator[Address]:
    """Run `modbus_server.c` and yield its address."""
    with contextlib.ExitStack() as stack:
        program = stack.enter_context(compiled("modbus_server.c"))
        if kind == "tcp":
            process = subprocess.Popen([program, kind], stdout=subprocess.PIPE, text=True)
            stack.callback(_end, process)
            yield Address(kind, f"127.0.0.1:{process.stdout.readline().strip()}")
            return
        ours, theirs = os.openpty()
        stack.callback(os.close, theirs)
        tty.setraw(theirs)
        process = subprocess.Popen([program, kind], stdin=ours)
        os.close(ours)
        stack.callback(_end, process)
        yield Address(kind, os.ttyname(theirs))


@contextlib.contextmanager
def emulator(kind: str, time_is: str = "virtual") -> Iterator[Address]:
    """The emulated bench; in virtual time each exchange is the next sample, in real time it uses its own clock."""
    wire = ["--rtu"] if kind == "rtu" else []
    with emulator_process(shipped("emulator.yaml"), "--port", "0", "--time", time_is, *wire) as serves:
        yield Address(kind, serves[kind])


@contextlib.contextmanager
def device_priority() -> Iterator[None]:
    """Start processes with real-time priority, since a real device does not wait for the scheduler of this machine."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(DEVICE_PRIORITY))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


def _end(process: subprocess.Popen) -> None:
    process.terminate()
    process.wait()
    if process.stdout:
        process.stdout.close()


@contextlib.contextmanager
def libmodbus_client() -> Iterator[Path]:
    """Compile `modbus_client.c` and yield the program."""
    with compiled("modbus_client.c", "-lmodbus") as program:
        yield program


def libmodbus_ns(program: Path, address: Address, count: int, period_us: int = 0) -> np.ndarray:
    """Durations of `count` exchanges [ns].

    Raises
    ------
    NotMeasuredError
        An exchange failed.
    """
    command = [program, address.kind, *address.arguments, str(count), str(period_us)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise NotMeasuredError(f"libmodbus: {done.stderr.strip()}")
    return np.array(done.stdout.split(), dtype=float)


def pymodbus_us(address: Address, count: int) -> Figures:
    """Percentiles of pymodbus' synchronous client [us]."""
    if address.kind == "tcp":
        client = ModbusTcpClient(address.host, port=address.port, timeout=1, retries=0)
    else:
        client = ModbusSerialClient(address.where, baudrate=BAUDRATE, timeout=1, retries=0)
    took_ns = np.empty(count)
    with client:
        for k in range(count):
            begun = time.perf_counter_ns()
            high, low = struct.unpack(">HH", struct.pack(">f", 0.0))
            reply = client.readwrite_registers(
                read_address=READ_AT,
                read_count=READS,
                write_address=WRITE_AT,
                values=[high, low, k & 0xFFFF],
                device_id=UNIT,
            )
            struct.unpack(">f", struct.pack(">HH", *reply.registers[:2]))
            took_ns[k] = time.perf_counter_ns() - begun
    return percentiles(took_ns[count // 10 :] * 1e-3)
