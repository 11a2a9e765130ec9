"""Peers written elsewhere: the daemon on servers by libmodbus and pymodbus; mbpoll and libmodbus on the emulator."""

import asyncio
import contextlib
import json
import os
import re
import select
import shutil
import struct
import subprocess
import threading
import tty
from pathlib import Path

import numpy as np
import pytest
import yaml
from pymodbus.client import ModbusTcpClient
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from piezod.recording import read_csv
from tests.benches.daemon import PATIENT, daemon
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benchmarks.compiled import compiled
from tests.benchmarks.table import NotMeasuredError

NEWTON_PER_VOLT, PRELOAD_N = 2.5, 10.0  # of libmodbus_server.c, and of the pymodbus device here
PEAK_V = 60.0
SLEW_V_PER_TICK = 4000.0 / 100.0  # limits.slew_V_per_s of config/bench.yaml at 100 Hz
BAUDRATE = 115200
MAPS = {"one exchange": (23, 23), "two exchanges": (16, 3)}

WITHOUT_OUTPUT_BIT = {"stale_after_ms": 500, "output_on_in_status": False}  # the device of another maker


@contextlib.contextmanager
def program(source, *arguments):
    """A C program beside this file, compiled; skipped aloud where libmodbus or a compiler is missing."""
    with contextlib.ExitStack() as stack:
        try:
            path = stack.enter_context(compiled(Path(__file__).with_name(source), "-lmodbus"))
        except NotMeasuredError as reason:
            pytest.skip(f"libmodbus: {reason} (apt-get install libmodbus-dev)")
        yield [str(path), *map(str, arguments)]


@contextlib.contextmanager
def started(command):
    """A server that prints its port; ended by its id."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        yield int(process.stdout.readline())
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@contextlib.contextmanager
def cable():
    """Two serial ports joined by a pump: what is written to one is read from the other."""
    pairs = [os.openpty() for _ in range(2)]
    stop = threading.Event()
    for _, slave in pairs:
        tty.setraw(slave)

    def pump():
        masters = [master for master, _ in pairs]
        while not stop.is_set():
            for ready in select.select(masters, [], [], 0.05)[0]:
                os.write(masters[1 - masters.index(ready)], os.read(ready, 4096))

    thread = threading.Thread(target=pump)
    thread.start()
    try:
        yield [os.ttyname(slave) for _, slave in pairs]
    finally:
        stop.set()
        thread.join()
        for pair in pairs:
            for descriptor in pair:
                os.close(descriptor)


@contextlib.contextmanager
def libmodbus_server(kind):
    with contextlib.ExitStack() as stack:
        if kind == "rtu":
            ours, theirs = stack.enter_context(cable())
            command = stack.enter_context(program("libmodbus_server.c", "rtu", theirs))
            stack.enter_context(started(command))
            yield {"rtu": ours}
        else:
            command = stack.enter_context(program("libmodbus_server.c", "tcp"))
            yield {"tcp": f"127.0.0.1:{stack.enter_context(started(command))}"}


class PymodbusDevice:
    """pymodbus' own server with plain registers; the spring is one callback, what was written is kept."""

    def __init__(self):
        self.written_V, self.ready, self.port = [], threading.Event(), 0
        self.thread = threading.Thread(target=lambda: asyncio.run(self.serve()))

    async def serve(self):
        self.loop, self.ended = asyncio.get_running_loop(), asyncio.Event()
        device = SimDevice(1, SimData(0, values=self.at_rest(), datatype=DataType.REGISTERS), action=self.act)
        server = ModbusTcpServer(device, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        self.port = server.transport.sockets[0].getsockname()[1]
        self.ready.set()
        await self.ended.wait()
        await server.shutdown()

    @staticmethod
    def at_rest():
        registers = [0] * 300
        registers[0:4] = [20570, 1, *words(1234.5)]
        registers[200:202] = words(PRELOAD_N)
        return registers

    async def act(self, _function, start, address, _count, registers, values):
        if values is not None and address == 100:
            voltage_V = floating(values[:2])
            self.written_V.append(voltage_V)
            registers[200 - start : 204 - start] = [*words(PRELOAD_N + NEWTON_PER_VOLT * voltage_V), *values[:2]]
            registers[205 - start] = values[2]
        if values is None and address == 200:
            registers[204 - start] = (registers[204 - start] + 1) % 65536

    @contextlib.contextmanager
    def running(self):
        self.thread.start()
        assert self.ready.wait(10)
        try:
            yield {"tcp": f"127.0.0.1:{self.port}"}
        finally:
            self.loop.call_soon_threadsafe(self.ended.set)
            self.thread.join()


def words(value):
    return list(struct.unpack(">2H", struct.pack(">f", value)))


def floating(two):
    return struct.unpack(">f", struct.pack(">2H", *two))[0]


def foreign_bench(folder, serves, write=23, read=23, **changes):
    """A bench file for a device of plain registers: no emulator's time, no PLC's reference."""
    path = bench_file(folder, serves, rate_Hz=100, limits=PATIENT | WITHOUT_OUTPUT_BIT, **changes)
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    registers = content["link"]["registers"]
    for role in ("virtual_time", "virtual_tick_us", "reference", "reference_counter"):
        del registers[role]
    for role, register in registers.items():
        if register["function"] == 23:
            register["function"] = write if role in ("voltage_setpoint", "command_sequence") else read
    content["arming"] |= {"reset_cycle": False}
    if "rtu" in serves:
        content["link"]["baudrate"] = BAUDRATE
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def recorded(folder, bench):
    """Triangles driven through the peer: the recording, after everything that must hold of it whatever the peer."""
    target = folder / "rec.csv"
    options = ("--excitation", "constant-triangles", "--peak", PEAK_V, "--frequency", 1.0, "--periods", 2)
    done = piezod("record", bench, *options, "-o", target)
    assert done.returncode == 0, done.stderr
    recording = read_csv(target)
    voltage_V, force_N = recording.channel("voltage_V"), recording.channel("force_N")
    assert voltage_V.max() == pytest.approx(PEAK_V, abs=1.3)  # a tick of 100 Hz moves 1.2 V
    assert recording.time_s.size > 100  # of 200 ticks: a machine that stands still loses some
    # These devices answer a command in the exchange that brings it, a real one in the next: a row earlier.
    np.testing.assert_allclose(force_N[:-1], PRELOAD_N + NEWTON_PER_VOLT * voltage_V[1:], atol=1e-4)
    return recording


@pytest.mark.parametrize(
    ("kind", "functions"), [("tcp", "one exchange"), ("tcp", "two exchanges"), ("rtu", "one exchange")]
)
def test_a_device_made_with_libmodbus_is_driven_and_its_force_recorded(kind, functions, tmp_path):
    with libmodbus_server(kind) as serves:
        recording = recorded(tmp_path, foreign_bench(tmp_path, serves, *MAPS[functions]))
        if kind == "tcp":
            host, _, port = serves["tcp"].rpartition(":")
            with ModbusTcpClient(host, port=int(port), timeout=2) as asked:
                kept = asked.read_holding_registers(100, count=23, device_id=1).registers
            assert floating(kept[0:2]) == 0.0  # ramped down
            assert kept[10] == PATIENT["device_watchdog_ms"]
            assert floating(kept[20:22]) == pytest.approx(recording.channel("voltage_V").max(), abs=1e-4)
            assert kept[22] >= recording.time_s.size


def test_a_device_made_with_libmodbus_is_armed_followed_and_disarmed_as_a_service(tmp_path):
    reference = {"kind": "triangle", "amplitude_N": 40, "offset_N": 80, "frequency_Hz": 1.0, "duration_s": None}
    with libmodbus_server("tcp") as serves:
        bench = foreign_bench(tmp_path, serves, reference=reference)
        with daemon(bench) as service:
            service.connected()
            service.tell("arm")
            service.wait_until(lambda: service.status()["tracking"]["ticks"] > 150, "150 ticks of the reference")
            running = service.status()
            service.tell("disarm")
            status = service.status()
            assert service.end() == 0
    assert running["state"] == "RUNNING"
    assert running["force_N"] == pytest.approx(PRELOAD_N + NEWTON_PER_VOLT * running["readback_V"], abs=0.01)
    assert running["temperature_C"] == 25.0
    assert (status["state"], status["voltage_V"], status["failed_exchanges"]) == ("DISARMED", 0.0, 0)


@pytest.mark.parametrize("functions", MAPS)
def test_pymodbus_own_server_with_plain_registers_is_driven_and_recorded(functions, tmp_path):
    device = PymodbusDevice()
    with device.running() as serves:
        recording = recorded(tmp_path, foreign_bench(tmp_path, serves, *MAPS[functions]))
    written_V = np.array(device.written_V)
    assert written_V.max() == pytest.approx(recording.channel("voltage_V").max(), abs=1e-4)
    assert written_V[-1] == 0.0
    assert (
        np.abs(np.diff(written_V)).max() <= SLEW_V_PER_TICK
    )  # from the first write to the last, also after lost ticks


def test_pymodbus_server_of_another_identity_is_not_driven(tmp_path):
    device = PymodbusDevice()
    device.at_rest = lambda: [4711, *PymodbusDevice.at_rest()[1:]]
    with device.running() as serves:
        done = piezod("run", foreign_bench(tmp_path, serves), "--arm")
    assert done.returncode == 78
    assert "registers.identity at address 0 is 4711, expected 20570" in done.stderr
    assert device.written_V == []


@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_libmodbus_reads_and_writes_the_emulated_bench(kind):
    wire = ["--rtu"] if kind == "rtu" else []
    with emulator("--port", "0", *wire) as serves:
        where = serves["tcp"].split(":") if kind == "tcp" else [serves["rtu"], BAUDRATE]
        with program("libmodbus_client.c", kind, *where) as command:
            done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    said = {name: value for name, _, value in (line.partition(" ") for line in done.stdout.splitlines())}
    assert done.returncode == 0, done.stdout
    exact = {"identity": "20570", "version": "1", "order_check": "1234.5", "echo": "7", "echo_of_one": "4711"}
    exact |= {"echo_of_both": "8", "no_such_address": "1", "too_high": "1", "back_to_rest": "1"}
    assert {name: said[name] for name in exact} == exact
    assert float(said["readback_at_60_V"]) == pytest.approx(60.0, abs=0.1)
    assert float(said["readback_as_input"]) == pytest.approx(60.0, abs=0.1)
    assert float(said["readback_at_90_V"]) == pytest.approx(90.0, abs=0.1)
    assert 50.0 < float(said["force_at_60_V"]) < float(said["force_at_90_V"]) < 360.0


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt-get install mbpoll)")
@pytest.mark.parametrize("kind", ["tcp", "rtu"])
def test_mbpoll_reads_and_writes_the_emulated_bench(kind):
    wire = ["--rtu"] if kind == "rtu" else []
    with emulator("--port", "0", *wire) as serves:
        host, _, port = serves["tcp"].rpartition(":")
        link = ["-m", "tcp", "-p", port] if kind == "tcp" else ["-m", "rtu", "-b", str(BAUDRATE), "-P", "none"]
        target = host if kind == "tcp" else serves["rtu"]

        def mbpoll(*arguments):
            command = ["mbpoll", "-0", "-a", "1", *link, *arguments]
            return subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout

        def value(address, *kind):
            return float(re.search(rf"\[{address}\]:\s+([-\d.]+)", mbpoll("-1", "-r", str(address), *kind, target))[1])

        decimal, whole = ("-B", "-t", "4:float"), ("-t", "4")
        assert value(0, *whole) == 20570
        assert "Written 1 references" in mbpoll("-r", "100", *decimal, target, "72.5")
        assert value(100, *decimal) == 72.5
        assert value(202, *decimal) == pytest.approx(72.5, abs=0.1)
        assert value(202, "-B", "-t", "3:float") == pytest.approx(72.5, abs=0.1)
        assert 50.0 < value(200, *decimal) < 300.0
        assert "Written 1 references" in mbpoll("-r", "110", *whole, target, "250")
        assert value(110, *whole) == 250


def test_the_bench_file_of_the_foreign_servers_fits_the_emulator_too(tmp_path):
    """The map of the foreign servers is that of config/bench.yaml, else the tests above would show nothing of it."""
    with emulator("--port", "0") as serves:
        done = piezod("check", foreign_bench(tmp_path, serves), "--json")
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)
