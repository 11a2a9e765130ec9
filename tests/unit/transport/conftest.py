"""Links to scripted devices, connected and after one valid exchange."""

import contextlib

import pytest

from piezod.config.link import ModbusRtuLink, ModbusTcpLink, RtuOverTcpLink, SerialLineLink
from piezod.transport import make_link
from tests.unit.transport.scripted import LINE, ScriptedGateway, ScriptedLine, ScriptedPty, ScriptedTcp, registers

TIMEOUT_S = 0.2  # a machine that is busy answers within this time
BAUDRATE = 921600


def tcp_config(port, **more):
    fields = {"kind": "modbus_tcp", "host": "127.0.0.1", "port": port, "timeout_s": TIMEOUT_S, "registers": registers()}
    return ModbusTcpLink.model_validate(fields | more)


def rtu_config(port, **more):
    fields = {
        "kind": "modbus_rtu",
        "port": port,
        "baudrate": BAUDRATE,
        "timeout_s": TIMEOUT_S,
        "registers": registers(),
    }
    return ModbusRtuLink.model_validate(fields | more)


def gateway_config(port, **more):
    fields = {"kind": "rtu_over_tcp", "host": "127.0.0.1", "port": port, "baudrate": BAUDRATE, "timeout_s": TIMEOUT_S}
    return RtuOverTcpLink.model_validate(fields | {"registers": registers()} | more)


def line_config(port, **more):
    fields = {"kind": "serial_line", "port": port, "baudrate": BAUDRATE, "timeout_s": TIMEOUT_S}
    return SerialLineLink.model_validate(fields | LINE | more)


MODBUS_WIRES = {
    "tcp": (ScriptedTcp, tcp_config),
    "rtu": (ScriptedPty, rtu_config),
    "gateway": (ScriptedGateway, gateway_config),
}
WIRES = MODBUS_WIRES | {"line": (ScriptedLine, line_config)}


@contextlib.contextmanager
def opened(server, config):
    link = make_link(config)
    link.open()
    try:
        yield link, server
    finally:
        link.close()


@contextlib.contextmanager
def connected(wire, **more):
    """A link over one of `WIRES`, and its scripted device."""
    server_class, make_config = WIRES[wire]
    with server_class() as server, opened(server, make_config(server.port, **more)) as pair:
        yield pair


def _after_one_exchange(wire):
    with connected(wire) as pair:
        assert pair[0].exchange(1.0) == 0
        yield pair


@pytest.fixture
def tcp():
    """A link over TCP after one valid exchange, and its scripted device."""
    yield from _after_one_exchange("tcp")


@pytest.fixture
def rtu():
    """A link over a pty after one valid exchange, and its scripted device."""
    yield from _after_one_exchange("rtu")


@pytest.fixture
def gateway():
    """A link to a serial gateway after one valid exchange, and its scripted device."""
    yield from _after_one_exchange("gateway")


@pytest.fixture
def line():
    """A link by ASCII lines over a pty after one valid exchange, and its scripted device."""
    yield from _after_one_exchange("line")
