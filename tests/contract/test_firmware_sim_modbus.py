"""The emulated bench as foreign clients see it: pymodbus over TCP and a pseudo-terminal, mbpoll, raw sockets."""

import contextlib
import json
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest
import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from tests.benches.processes import Popen

ROOT = Path(__file__).parents[2]
EMULATOR = ROOT / "config" / "emulator.yaml"


@contextlib.contextmanager
def emulator(*arguments, config=EMULATOR):
    process = Popen(
        [sys.executable, "-m", "firmware_sim", str(config), "--port", "0", "--until-stdin-closes", *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        yield json.loads(process.stdout.readline()), process
    finally:
        process.stdin.close()
        assert process.wait(timeout=10) == 0
        process.stdout.close()


@pytest.fixture(scope="module")
def real():
    with emulator("--rtu", "--line") as (serves, _):
        yield serves


@pytest.fixture(params=["tcp", "rtu"])
def client(request, real):
    if request.param == "tcp":
        host, _, port = real["tcp"].partition(":")
        opened = ModbusTcpClient(host, port=int(port), timeout=2, retries=0)
    else:
        opened = ModbusSerialClient(real["rtu"], baudrate=921600, timeout=2, retries=0)
    assert opened.connect()
    yield opened
    opened.close()


def raw(real):
    host, _, port = real["tcp"].partition(":")
    return socket.create_connection((host, int(port)), timeout=2)


def words(voltage_V, sequence):
    return [*struct.unpack(">2H", struct.pack(">f", voltage_V)), sequence]


def read_block(registers):
    return struct.unpack(">ffHHHffH", struct.pack(">12H", *registers))


def wait_for(condition, timeout_s=5.0):
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return False


def test_writing_and_reading_in_one_exchange_or_in_two_agree(client):
    answer = client.readwrite_registers(read_address=200, read_count=12, write_address=100, values=words(60.0, 11))
    assert not answer.isError()
    assert read_block(answer.registers)[3] == 11
    assert not client.write_registers(100, words(60.0, 12)).isError()
    time.sleep(0.02)
    holding = read_block(client.read_holding_registers(200, count=12).registers)
    inputs = read_block(client.read_input_registers(200, count=12).registers)
    for block in (holding, inputs):
        assert block[1] == pytest.approx(60.0, abs=0.05)
        assert block[0] == pytest.approx(holding[0], abs=1.5)
        assert block[3:5] == (12, 1)
    assert (inputs[2] - holding[2]) % 65536 < 4000


def test_a_single_register_is_written_and_echoed(client):
    answer = client.write_register(102, 4711)
    assert (answer.address, answer.registers) == (102, [4711])
    assert client.read_holding_registers(205, count=1).registers == [4711]


def test_refusals_carry_their_exception_code(client):
    assert client.read_holding_registers(150, count=1).exception_code == 2
    assert client.write_register(0, 1).exception_code == 2
    assert client.write_registers(100, words(float("nan"), 1)).exception_code == 3
    assert client.write_registers(100, words(500.0, 1)).exception_code == 3
    exchanged = client.readwrite_registers(read_address=300, read_count=2, write_address=100, values=words(33.0, 1))
    assert exchanged.exception_code == 2
    assert client.read_coils(0, count=1).exception_code == 1


def test_a_refused_exchange_writes_nothing(client):
    client.write_registers(100, words(44.0, 5))
    client.readwrite_registers(read_address=300, read_count=2, write_address=100, values=words(33.0, 6))
    assert client.read_holding_registers(100, count=3).registers == words(44.0, 5)


def test_the_watchdog_acts_without_any_request(real):
    with raw(real) as connection, contextlib.ExitStack() as stack:
        modbus = ModbusTcpClient(real["tcp"].split(":")[0], port=int(real["tcp"].split(":")[1]), timeout=2, retries=0)
        modbus.connect()
        stack.callback(modbus.close)
        assert modbus.read_holding_registers(110, count=1).registers == [0]
        modbus.write_registers(110, [40])
        stack.callback(modbus.write_registers, 110, [0])
        modbus.write_registers(100, words(50.0, 1))
        assert connection.fileno() >= 0
        assert wait_for(lambda: read_block(modbus.read_holding_registers(200, count=12).registers)[4] & 2)
        assert wait_for(lambda: abs(read_block(modbus.read_holding_registers(200, count=12).registers)[1]) < 0.05)
        modbus.write_registers(100, words(20.0, 2))
        assert wait_for(lambda: abs(read_block(modbus.read_holding_registers(200, count=12).registers)[1] - 20.0) < 0.1)


def test_frames_may_come_in_pieces_and_in_bunches(real):
    frame = struct.pack(">HHHBBHH", 9, 0, 6, 1, 3, 0, 2)
    with raw(real) as connection:
        for byte in frame:
            connection.sendall(bytes([byte]))
            time.sleep(0.001)
        expected = struct.pack(">HHHBBBHH", 9, 0, 7, 1, 3, 4, 20570, 1)
        assert connection.recv(64) == expected
        connection.sendall(3 * frame)
        received = b""
        while len(received) < 3 * len(expected):
            received += connection.recv(256)
        assert received == 3 * expected


@pytest.mark.parametrize(
    "garbage",
    [
        struct.pack(">HHHBB", 1, 7, 2, 1, 3),
        struct.pack(">HHHBB", 1, 0, 0, 1, 3),
        struct.pack(">HHHBB", 1, 0, 65535, 1, 3),
        b"GET / HTTP/1.1\r\n\r\n",
    ],
)
def test_what_cannot_be_modbus_ends_the_connection(real, garbage):
    with raw(real) as connection:
        connection.sendall(garbage)
        with contextlib.suppress(ConnectionResetError):
            assert connection.recv(64) == b""


@pytest.mark.parametrize(
    ("pdu", "code"),
    [
        (struct.pack(">BHH", 3, 200, 0), 3),
        (struct.pack(">BHH", 3, 200, 126), 3),
        (struct.pack(">BHHB", 16, 100, 3, 4) + bytes(6), 3),
        (struct.pack(">BHHB", 16, 100, 0, 0), 3),
        (struct.pack(">BH", 3, 200), 3),
        (struct.pack(">B", 99), 1),
    ],
)
def test_malformed_requests_are_answered_with_an_exception(real, pdu, code):
    with raw(real) as connection:
        connection.sendall(struct.pack(">HHHB", 5, 0, len(pdu) + 1, 1) + pdu)
        assert connection.recv(64) == struct.pack(">HHHBBB", 5, 0, 3, 1, pdu[0] | 0x80, code)


def test_another_unit_is_not_us(real):
    with raw(real) as connection:
        connection.sendall(struct.pack(">HHHBBHH", 9, 0, 6, 42, 3, 0, 2))
        assert connection.recv(64)[7:] == bytes([0x83, 11])


def test_noise_on_the_serial_line_is_survived(real):
    with serial.Serial(real["rtu"], timeout=0.3) as port:
        port.write(b"\x00\xff\x01\x03\x99")
        assert port.read(64) == b""
    client = ModbusSerialClient(real["rtu"], baudrate=921600, timeout=2, retries=0)
    assert client.connect()
    time.sleep(0.1)
    assert client.read_holding_registers(0, count=1).registers == [20570]
    client.close()


def test_the_line_protocol_sets_and_measures(real):
    with serial.Serial(real["line"], timeout=2) as port:

        def ask(line):
            port.write(line)
            return port.readline().decode()

        assert ask(b"IDN?\n").startswith("PIEZO-BENCH,20570")
        assert ask(b"WDT?\n") == "0\n"
        port.write(b"SVA A 31.5\n")
        time.sleep(0.05)
        pattern = r"(-?[\d.]+),(-?[\d.]+),(\d+),(\d+),(\d+),(-?[\d.]+)\n"
        force, voltage, _, _, status, _ = map(float, re.fullmatch(pattern, ask(b"MEAS?\n")).groups())
        assert voltage == pytest.approx(31.5, abs=0.05)
        assert force > 10.0
        assert status == 1
        assert ask(b"SVA A 999\n") == "ERR 3\n"
        assert ask(b"SVA A nan\n") == "ERR 2\n"
        assert ask(b"WHAT?\n") == "ERR 1\n"


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt-get install mbpoll)")
def test_mbpoll_reads_the_force_and_writes_the_set_point(real):
    host, _, port = real["tcp"].partition(":")

    def mbpoll(*arguments):
        command = ["mbpoll", "-0", "-m", "tcp", "-p", port, "-a", "1", "-B", "-t", "4:float", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout

    assert "Written 1 references" in mbpoll("-r", "100", host, "72.5")
    voltage = re.search(r"\[202\]:\s+([-\d.]+)", mbpoll("-1", "-r", "202", host))
    assert float(voltage.group(1)) == pytest.approx(72.5, abs=0.05)
    force = re.search(r"\[200\]:\s+([-\d.]+)", mbpoll("-1", "-r", "200", host))
    assert 50.0 < float(force.group(1)) < 300.0


def test_virtual_time_gives_the_same_answers_to_the_bit():
    answers = []
    for _ in range(2):
        with (
            emulator("--time", "virtual", "--seed", "5", "--effect", "creep") as (serves, _),
            raw(serves) as connection,
        ):
            assert serves["time"] == "virtual"
            record = b""
            for k in range(300):
                pdu = struct.pack(">BHHHHBfH", 23, 200, 9, 100, 3, 6, 70.0 + 0.2 * (k % 90), k)
                connection.sendall(struct.pack(">HHHB", k, 0, len(pdu) + 1, 1) + pdu)
                record += connection.recv(64)
            answers.append(record)
    assert answers[0] == answers[1]


def test_a_second_client_is_turned_away_when_only_one_is_wanted(tmp_path):
    config = tmp_path / "emulator.yaml"
    config.write_text("schema: firmware_sim.emulator/1\ntcp: {one_client: true}\n", encoding="utf-8")
    request = struct.pack(">HHHBBHH", 9, 0, 6, 1, 3, 0, 2)
    with emulator(config=config) as (serves, _):
        with raw(serves) as first:
            first.sendall(request)
            assert first.recv(64)
            with raw(serves) as second, contextlib.suppress(ConnectionResetError):
                assert second.recv(64) == b""
        time.sleep(0.05)
        with raw(serves) as third:
            third.sendall(request)
            assert third.recv(64)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_cleanly(number):
    with emulator() as (_, process):
        process.send_signal(number)
        assert process.wait(timeout=10) == 0


def test_a_busy_port_and_a_bad_file_have_their_exit_codes(real, tmp_path):
    port = real["tcp"].partition(":")[2]
    bad = tmp_path / "bad.yaml"
    bad.write_text("schema: firmware_sim.emulator/1\nsead: 1\n", encoding="utf-8")
    for arguments, code, part in (([EMULATOR, "--port", port], 75, port), ([bad], 78, "bad.yaml:2")):
        command = [sys.executable, "-m", "firmware_sim", *map(str, arguments)]
        ended = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        assert ended.returncode == code
        assert part in ended.stderr
        assert ended.stderr.count("\n") == 1
