"""Bad input at the command: one line, the right exit code, and no voltage on the wire."""

import json
import socket
import struct
import sys
import threading

import pytest

from tests.benches.emulator import BENCH, EMULATOR, ROOT, bench_file, emulator, piezod
from tests.benches.processes import run

SET_POINT = 100


class SilentDevice:
    """Accepts, reads, never answers; keeps what it was sent."""

    def __init__(self):
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.received = []
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def serve(self):
        while True:
            try:
                connection, _ = self.server.accept()
            except OSError:
                return
            with connection:
                while data := connection.recv(1024):
                    self.received.append(data)

    def close(self):
        self.server.close()
        self.thread.join(timeout=1)


def writes_of(frames):
    """Function codes that write the set point among Modbus TCP frames."""
    return [frame for frame in frames if len(frame) > 7 and frame[7] in (6, 16, 23)]


def one_line(done, code):
    lines = done.stderr.strip().splitlines()
    assert done.returncode == code, done.stderr
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.stderr
    return lines[0]


@pytest.fixture
def bench_copy(tmp_path):
    """The shipped bench file with one replacement."""

    def write(old, new):
        text = BENCH.read_text(encoding="utf-8").replace(
            "model: model.yaml", f"model: {ROOT / 'config' / 'model.yaml'}"
        )
        assert old in text
        path = tmp_path / "bench.yaml"
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
        return path

    return write


def test_a_wrong_configuration_ends_with_78_and_one_line(bench_copy):
    assert "unknown key rate" in one_line(piezod("run", bench_copy("rate_Hz: 1000", "rate: 1000"), "--arm"), 78)


def test_a_model_of_another_schema_ends_with_78(bench_copy, tmp_path):
    (tmp_path / "old.yaml").write_text("schema: piezod.model/0\n", encoding="utf-8")
    path = bench_copy("model.yaml", "/old.yaml")
    path.write_text(path.read_text().replace(str(ROOT / "config" / "/old.yaml"), "old.yaml"), encoding="utf-8")
    text = path.read_text(encoding="utf-8")
    path.write_text(
        "\n".join("model: old.yaml" if x.startswith("model:") else x for x in text.splitlines()), encoding="utf-8"
    )
    assert "schema is 'piezod.model/0', must be 'piezod.model/1'" in one_line(piezod("run", path, "--arm"), 78)


def test_a_missing_device_exits_with_75(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    path = bench_file(tmp_path, {"tcp": f"127.0.0.1:{port}"})
    assert "refused" in one_line(piezod("run", path, "--arm"), 75)


def test_a_device_that_never_answers_ends_with_75_and_nothing_written(tmp_path):
    device = SilentDevice()
    path = bench_file(tmp_path, {"tcp": f"127.0.0.1:{device.port}"})
    one_line(piezod("run", path, "--arm"), 75)
    device.close()
    assert device.received
    assert not writes_of(device.received)


def test_another_identity_ends_with_78_and_names_both_and_writes_nothing(tmp_path):
    device = socket.create_server(("127.0.0.1", 0))
    seen = []

    def answer():
        connection, _ = device.accept()
        with connection:
            while request := connection.recv(260):
                seen.append(request)
                address, count = struct.unpack(">HH", request[8:12])
                registers = struct.pack(">f", 1234.5) if address == 2 else b"\x00\x07" * count
                body = bytes([request[6], request[7], 2 * count]) + registers
                connection.sendall(request[:4] + struct.pack(">H", len(body)) + body)

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    path = bench_file(tmp_path, {"tcp": f"127.0.0.1:{device.getsockname()[1]}"})
    line = one_line(piezod("run", path, "--arm"), 78)
    device.close()
    assert "20570" in line
    assert "7" in line
    assert not writes_of(seen)


def test_a_rate_above_the_wire_is_refused_with_its_floor(tmp_path):
    path = bench_file(tmp_path, {"rtu": "/dev/none"})
    path.write_text(path.read_text(encoding="utf-8").replace("921600", "115200"), encoding="utf-8")
    line = one_line(piezod("run", path, "--arm"), 78)
    assert "rate_Hz is 1000, must be at most" in line


def test_a_serial_port_that_is_not_there_ends_with_75(tmp_path):
    path = bench_file(tmp_path, {"rtu": "/dev/ttyNONE0"})
    assert "/dev/ttyNONE0" in one_line(piezod("run", path, "--arm"), 75)


def test_the_emulator_says_when_its_port_is_in_use():
    with emulator("--port", "0") as serves:
        port = serves["tcp"].rpartition(":")[2]
        done = run([sys.executable, "-m", "firmware_sim", str(EMULATOR), "--port", port], timeout=30)
    assert done.returncode == 75
    assert len(done.stderr.strip().splitlines()) == 1
    assert port in done.stderr


def test_an_unknown_excitation_and_a_peak_above_the_limit_end_with_2(tmp_path):
    path = bench_file(tmp_path, {"tcp": "127.0.0.1:1"})
    output = tmp_path / "x.csv"
    assert "must be one of" in one_line(piezod("record", path, "--excitation", "chirp", "-o", output), 2)
    line = one_line(piezod("record", path, "--excitation", "constant-triangles", "--peak", "200", "-o", output), 2)
    assert "at most 140 V" in line
    assert not output.exists()


OTHER_OUTPUT = (
    "unit: N",
    "unit: um",
    "output.unit is 'um' (column force_N), must be 'N' to drive a bench; identify on",
)
OTHER_INPUT = (
    "unit: V",
    "unit: mm",
    "input.unit is 'mm' (column voltage_V), must be 'V' to drive a bench; identify on",
)


@pytest.mark.parametrize(
    ("command", "old", "new", "says"),
    [("run", *OTHER_OUTPUT), ("run", *OTHER_INPUT), ("check", *OTHER_OUTPUT), ("validate", *OTHER_INPUT)],
)
def test_a_model_of_other_units_than_the_benchs_is_refused_before_the_device_is_spoken_to(
    tmp_path, command, old, new, says
):
    text = (ROOT / "config" / "model.yaml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    model = tmp_path / "other.yaml"
    model.write_text(text.replace(old, new), encoding="utf-8")
    device = SilentDevice()
    path = bench_file(tmp_path, {"tcp": f"127.0.0.1:{device.port}"}, model=str(model))
    options = {"run": ["--arm"], "check": [], "validate": ["--model", model]}[command]
    assert f"{model}: {says}" in one_line(piezod(command, path, *options), 78)
    device.close()
    assert not device.received


@pytest.mark.parametrize(
    ("target", "says"), [("x.txt", "suffix is '.txt', must be one of .csv"), ("no/x.csv", "no must be a folder")]
)
def test_a_recording_that_could_not_be_written_is_refused_before_the_device_is_spoken_to(tmp_path, target, says):
    device = SilentDevice()
    path = bench_file(tmp_path, {"tcp": f"127.0.0.1:{device.port}"})
    done = piezod("record", path, "--excitation", "constant-triangles", "-o", tmp_path / target)
    assert says in one_line(done, 78)
    device.close()
    assert not device.received


def test_check_never_writes_and_says_ok(tmp_path):
    with emulator("--port", "0") as serves:
        done = piezod("check", bench_file(tmp_path, serves), "--json")
    checks = json.loads(done.stdout)
    assert done.returncode == 0, done.stdout
    assert {one["name"] for one in checks} >= {"configuration", "model", "link", "exchange", "force", "clock"}
    assert not [one for one in checks if one["level"] == "FAIL"]


def test_check_says_what_fails_and_exits_with_1(tmp_path):
    done = piezod("check", bench_file(tmp_path, {"tcp": "127.0.0.1:1"}))
    assert done.returncode == 1
    assert "FAIL  link: " in done.stdout
