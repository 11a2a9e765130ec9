"""Links against the servers of pymodbus, an independent implementation of Modbus."""

import asyncio
import os
import select
import threading
import tty

import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from piezod.errors import ConfigurationError
from piezod.transport import ExchangeResult
from tests.unit.transport.conftest import opened, rtu_config, tcp_config
from tests.unit.transport.scripted import registers

STATIC = ("heartbeat", "command_echo", "command_sequence")
PATHS = [(23, 23), (16, 3), (16, 4)]


def device():
    values = [0] * 300
    values[0] = 20570
    values[2:4] = ModbusTcpClient.convert_to_registers(1234.5, ModbusTcpClient.DATATYPE.FLOAT32)
    values[200:202] = ModbusTcpClient.convert_to_registers(55.5, ModbusTcpClient.DATATYPE.FLOAT32)
    values[206] = 5
    return SimDevice(1, simdata=[SimData(0, values=values, datatype=DataType.REGISTERS)])


class Served:
    """A pymodbus server in a thread."""

    def __init__(self, make):
        self._make, self._loop = make, asyncio.new_event_loop()
        self._started = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        assert self._started.wait(5)
        return self

    def __exit__(self, *_):
        asyncio.run_coroutine_threadsafe(self.server.shutdown(), self._loop).result(5)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5)
        self._loop.close()

    def _run(self):
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._start())
        self._started.set()
        self._loop.run_forever()

    async def _start(self):
        self.server = self._make()
        await self.server.serve_forever(background=True)


@pytest.fixture(scope="module")
def port():
    with Served(lambda: ModbusTcpServer(device(), address=("127.0.0.1", 0))) as served:
        yield served.server.transport.sockets[0].getsockname()[1]


@pytest.fixture(scope="module")
def client(port):
    with ModbusTcpClient("127.0.0.1", port=port, timeout=1, retries=0) as connected:
        yield connected


def stored_V(client, address=100, **order):
    words = client.read_holding_registers(address, count=2, device_id=1).registers
    return client.convert_from_registers(words, client.DATATYPE.FLOAT32, **order)


@pytest.mark.parametrize(("write", "read"), PATHS)
def test_pymodbus_accepts_every_combination_of_functions(port, client, write, read):
    config = tcp_config(port, timeout_s=1.0, registers=registers(write, read, without=STATIC))
    with opened(None, config) as (link, _):
        assert link.exchange(12.25 + write + read) is ExchangeResult.OK
        assert link.reading.force_N == 55.5
        assert link.reading.status == 5
        assert stored_V(client) == 12.25 + write + read
        assert link.poll() is ExchangeResult.OK


def test_pymodbus_accepts_the_single_register_write(port, client):
    single = registers(6, 3, without=STATIC)
    single["voltage_setpoint"] |= {"type": "uint16", "scale": 0.01}
    with opened(None, tcp_config(port, timeout_s=1.0, registers=single)) as (link, _):
        assert link.exchange(12.344) is ExchangeResult.OK
        assert link.written_V == pytest.approx(12.34)
        assert client.read_holding_registers(100, count=1, device_id=1).registers == [1234]


def test_pymodbus_decodes_the_configured_word_order(port, client):
    swapped = registers(without=STATIC)
    swapped["voltage_setpoint"] |= {"order": "CDAB"}
    with opened(None, tcp_config(port, timeout_s=1.0, registers=swapped)) as (link, _):
        assert link.exchange(-3.5) is ExchangeResult.OK
        assert stored_V(client, word_order="little") == -3.5


def test_an_address_outside_the_map_gives_an_exception(port):
    outside = registers(without=STATIC)
    outside["force"] |= {"address": 290}
    outside["voltage_readback"] |= {"address": 299}
    with opened(None, tcp_config(port, timeout_s=1.0, registers=outside)) as (link, _):
        assert link.exchange(1.0) is ExchangeResult.DEVICE_EXCEPTION
        assert link.last_exception == 2
        outside_role = "voltage_readback"
        with pytest.raises(ConfigurationError, match="at address 299: exception 2, illegal address"):
            link.read_register(outside_role)


class Cable:
    """Two connected pseudo-terminals."""

    def __enter__(self):
        pairs = [os.openpty(), os.openpty()]
        for _, slave in pairs:
            tty.setraw(slave)
        self._masters = [master for master, _ in pairs]
        self._slaves = [slave for _, slave in pairs]
        self.ports = [os.ttyname(slave) for slave in self._slaves]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._carry)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join(5)
        for descriptor in (*self._masters, *self._slaves):
            os.close(descriptor)

    def _carry(self):
        first, second = self._masters
        while not self._stop.is_set():
            for master in select.select(self._masters, [], [], 0.02)[0]:
                os.write(second if master == first else first, os.read(master, 4096))


@pytest.mark.parametrize(("write", "read"), PATHS)
def test_pymodbus_accepts_every_combination_of_functions_over_a_serial_line(write, read):
    with Cable() as cable:

        def make():
            return ModbusSerialServer(device(), framer=FramerType.RTU, port=cable.ports[1], baudrate=115200)

        config = rtu_config(
            cable.ports[0], baudrate=115200, timeout_s=1.0, registers=registers(write, read, without=STATIC)
        )
        with Served(make), opened(None, config) as (link, _):
            assert link.exchange(7.5) is ExchangeResult.OK
            assert link.reading.force_N == 55.5
            assert link.read_register("voltage_setpoint") == 7.5
