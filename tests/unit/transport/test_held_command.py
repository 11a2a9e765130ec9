"""The command that the device holds is compared with the last one written."""

import struct

import pytest

from piezod.errors import ConfigurationError
from piezod.transport import ExchangeResult
from tests.unit.transport.conftest import MODBUS_WIRES, connected
from tests.unit.transport.scripted import registers

OK, CHANGED, FOREIGN = ExchangeResult.OK, ExchangeResult.SETPOINT_CHANGED, ExchangeResult.FOREIGN_COMMAND
UNNUMBERED = ("command_sequence", "command_echo")


@pytest.mark.parametrize("wire", MODBUS_WIRES)
@pytest.mark.parametrize("functions", [(23, 23), (16, 3)])
def test_the_last_bit_of_a_foreign_voltage_is_found(wire, functions):
    with connected(wire, setpoint_readable=True, registers=registers(*functions)) as (link, server):
        assert link.exchange(40.0) is OK
        assert link.compare_command() is OK
        server.bench.put(100, ">I", struct.unpack(">I", struct.pack(">f", 40.0))[0] + 1)
        assert link.compare_command() is CHANGED
        assert link.exchange(40.0) is OK
        assert link.compare_command() is OK


def test_a_foreign_number_is_a_foreign_command_also_at_the_same_voltage():
    with connected("tcp", setpoint_readable=True) as (link, server):
        assert link.exchange(40.0) is OK
        server.bench.put(102, ">H", server.bench.get(102, ">H") + 1)
        assert link.compare_command() is FOREIGN


def test_without_a_number_the_voltage_alone_is_compared():
    integer = {"address": 100, "function": 6, "type": "int16", "scale": 0.01, "unit": "V"}
    entries = registers(6, 3, without=UNNUMBERED, voltage_setpoint=integer)
    with connected("tcp", setpoint_readable=True, registers=entries) as (link, server):
        assert link.exchange(40.0) is OK
        assert link.compare_command() is OK
        server.bench.put(100, ">h", 4001)
        assert link.compare_command() is CHANGED


def test_a_voltage_alone_is_not_found_where_only_the_number_can_be_read(tcp):
    link, server = tcp
    assert link.holds_command
    server.bench.put(100, ">f", 50.0)
    assert link.compare_command() is OK


def test_without_number_and_readable_set_point_nothing_is_compared():
    with connected("tcp", registers=registers(without=UNNUMBERED)) as (link, server):
        assert link.exchange(1.0) is OK
        assert not link.holds_command
        requests = len(server.bench.requests)
        assert link.compare_command() is OK
        assert len(server.bench.requests) == requests


def test_a_device_that_refuses_to_show_its_set_point_is_found_before_a_voltage_is_written():
    with connected("tcp", setpoint_readable=True) as (link, server):
        good = server.good
        refusal = lambda frame: [frame[:5] + bytes([3, frame[6], frame[7] | 0x80, 2])]  # noqa: E731
        server.answer = lambda frame, _: refusal(frame) if frame[7:10] == b"\x03\x00\x64" else [good(frame)]
        with pytest.raises(ConfigurationError, match=r"voltage_setpoint at address 100: exception 2, illegal address"):
            link.identify()
        assert server.bench.voltage_V == 0.0
