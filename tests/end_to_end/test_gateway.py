"""Modbus RTU over TCP: the emulated bench behind a serial gateway, and the RTU server of pymodbus."""

import asyncio
import json
import threading
import time
import zipfile

import pytest
import yaml
from pymodbus import ModbusDeviceIdentification
from pymodbus.framer import FramerType
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from piezod.config import load_bench
from piezod.config.link import RtuOverTcpLink
from piezod.errors import UnreachableError
from piezod.session.device_names import device_names
from piezod.transport import ExchangeResult, make_link, max_wire_rate_Hz, verify_identity
from piezod.transport.probe import modbus_name, rtu_name
from tests.benches.daemon import daemon
from tests.benches.emulator import bench_file, emulator, piezod
from tests.benches.gateway import Gateway


@pytest.fixture
def bench(tmp_path):
    """Bench file for the emulator behind a gateway, and the gateway."""
    with emulator("--port", "0", "--rtu") as serves, Gateway(serves["rtu"]) as gateway:
        path = bench_file(tmp_path, serves, rate_Hz=100, limits={"stale_after_ms": 40})
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        registers = content["link"]["registers"]
        where = {"host": "127.0.0.1", "port": gateway.tcp_port, "baudrate": 921600, "timeout_s": 0.5}
        content["link"] = {"kind": "rtu_over_tcp", "registers": registers} | where
        path.write_text(yaml.safe_dump(content), encoding="utf-8")
        yield path, gateway


def until_good(link, voltage_V, seconds=5.0):
    end_s, results = time.monotonic() + seconds, []
    while not results or results[-1] is not ExchangeResult.OK:
        assert time.monotonic() < end_s, results[-5:]
        results.append(link.exchange(voltage_V))
        time.sleep(0.01)
    return results


def test_the_emulated_bench_answers_through_a_gateway(bench):
    path, _ = bench
    link = make_link(load_bench(path).link)
    link.open()
    try:
        verify_identity(link)
        before = link.reading.heartbeat
        for voltage_V in (1.0, 2.0, 3.0):
            assert link.exchange(voltage_V) is ExchangeResult.OK
            assert link.written_V == voltage_V
            time.sleep(0.01)  # the heartbeat of the device advances with its clock
        assert (link.reading.heartbeat - before) % 65536 >= 2
    finally:
        link.close()


def test_a_cut_connection_costs_one_exchange_and_is_verified_again(bench):
    path, gateway = bench
    link = make_link(load_bench(path).link)
    link.open()
    try:
        verify_identity(link)
        assert link.exchange(1.0) is ExchangeResult.OK
        for number in range(3):
            gateway.cut()
            time.sleep(0.1)
            results = until_good(link, 2.0)
            assert results[:-1], "the cut was not seen"
            assert set(results[:-1]) <= {ExchangeResult.DISCONNECTED, ExchangeResult.TIMEOUT}
            assert gateway.connections == number + 2
            assert link.written_V == 2.0
    finally:
        link.close()


def test_a_command_line_check_reaches_the_device_through_the_gateway(bench):
    path, _ = bench
    done = piezod("check", path)
    assert "rtu_over_tcp 127.0.0.1:" in done.stdout
    assert "FAIL" not in [
        line.split()[0] for line in done.stdout.splitlines() if line.startswith(("OK", "FAIL", "WARN"))
    ]


def test_a_gateway_that_is_away_is_one_line():
    config = RtuOverTcpLink.model_validate({"kind": "rtu_over_tcp", "host": "127.0.0.1", "port": 1, "registers": {}})
    with pytest.raises(UnreachableError, match="refused the connection"):
        make_link(config).open()


def gateway_link(**more):
    fields = {"kind": "rtu_over_tcp", "host": "127.0.0.1", "port": 4001, "registers": {}}
    return RtuOverTcpLink.model_validate(fields | more)


def test_the_line_behind_the_gateway_limits_the_rate():
    force = {"address": 0, "function": 3, "unit": "N"}
    slow = gateway_link(baudrate=9600, registers={"force": force})
    characters = 8 + 5 + 4  # request; head and checksum of the reply; one float
    seconds = characters * 11 / 9600 + 2 * 3.5 * 11 / 9600
    assert max_wire_rate_Hz(slow) == pytest.approx(1.0 / seconds)


def test_two_units_behind_one_gateway_are_one_line():
    assert device_names(gateway_link(unit_id=1)) == device_names(gateway_link(unit_id=2))
    assert device_names(gateway_link(port=4002)) != device_names(gateway_link())


def test_a_routable_gateway_is_refused():
    with pytest.raises(ValueError, match="set allow_plaintext_remote: true"):
        gateway_link(host="8.8.8.8")


def test_the_rtu_server_of_pymodbus_answers():
    """FramerType.RTU over TCP, as pymodbus serves it."""
    started, ready = {}, threading.Event()

    identity = ModbusDeviceIdentification(info_name={"VendorName": "Maker", "ProductCode": "GW-1"})

    async def serve():
        device = SimDevice(1, simdata=[SimData(0, values=[20570], count=200, datatype=DataType.REGISTERS)])
        server = ModbusTcpServer(device, framer=FramerType.RTU, address=("127.0.0.1", 0), identity=identity)
        started.update(loop=asyncio.get_running_loop(), server=server)
        await server.serve_forever(background=True)
        started["port"] = server.transport.sockets[0].getsockname()[1]
        ready.set()
        await server.serving

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    assert ready.wait(10)
    registers = {"identity": {"address": 0, "function": 3, "type": "uint16", "expect": 20570}}
    link = make_link(gateway_link(port=started["port"], timeout_s=1.0, registers=registers))
    link.open()
    try:
        assert link.read_register("identity") == 20570
        link.identify()
        link.close()  # the server has one client at a time, as a gateway has
        assert modbus_name("127.0.0.1", started["port"], 1, rtu=True).startswith("Maker GW-1")
    finally:
        link.close()
        asyncio.run_coroutine_threadsafe(started["server"].shutdown(), started["loop"]).result(10)
        thread.join(10)


def test_the_device_behind_a_gateway_is_discovered_by_its_frames(bench):
    _, gateway = bench
    done = piezod("init", "--discover", "--host", "127.0.0.1", "--port", gateway.tcp_port)
    assert done.returncode == 0, done.stderr
    assert f"rtu_over_tcp 127.0.0.1:{gateway.tcp_port} unit 1: a device without a name" in done.stdout


def test_a_device_with_tcp_frames_is_discovered_by_its_frames():
    with emulator("--port", "0") as serves:
        host, _, port = serves["tcp"].rpartition(":")
        done = piezod("init", "--discover", "--host", host, "--port", port, "--json")
    assert f"modbus_tcp {host}:{port} unit 1: a device without a name" in done.stdout


def test_a_device_on_a_serial_line_answers(tmp_path):
    with emulator("--port", "0", "--rtu") as serves:
        link = load_bench(bench_file(tmp_path, serves)).link
        assert rtu_name(link) == "a device without a name (it does not know function 43)"


def test_status_and_bundle_show_the_bytes_of_a_damaged_reply(bench, tmp_path):
    path, gateway = bench
    with daemon(path) as service:
        service.connected()
        gateway.change_next = lambda reply: bytes((reply[0] ^ 0x40,)) + reply[1:]
        end_s = time.monotonic() + 10.0
        while (kept := service.tell("status")["bad_exchange"]) is None or kept["result"] != "bad_crc":
            assert time.monotonic() < end_s, kept
            time.sleep(0.05)
        done = piezod("support-bundle", path, "-o", tmp_path / "out.zip")
    assert done.returncode == 0, done.stderr
    with zipfile.ZipFile(tmp_path / "out.zip") as bundle:
        bundled = json.loads(bundle.read("status.json"))["bad_exchange"]
    assert bundled["result"] == "bad_crc"
    request, reply = bytes.fromhex(bundled["request"]), bytes.fromhex(bundled["reply"])
    assert reply[0] == request[0] ^ 0x40
    assert reply[1] == request[1]
