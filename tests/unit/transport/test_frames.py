"""Request frames against the examples of the Modbus specification, and the rate limits of the wires."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from piezod.transport import max_wire_rate_Hz
from piezod.transport.frames import crc16, read_request, read_write_request, write_request
from tests.unit.transport.conftest import line_config, rtu_config, tcp_config
from tests.unit.transport.scripted import crc, registers

FORCE_ONLY = ("command_sequence", "voltage_readback", "heartbeat", "command_echo", "status")


def test_the_read_write_request_equals_the_example_of_the_specification():
    """MODBUS Application Protocol 1.1b3, 6.17: read six registers from 3, write three from 14."""
    request = read_write_request("tcp", 1, 3, 6, 14, 3)
    request.frame[request.values_at :] = bytes.fromhex("00FF 00FF 00FF")
    assert request.frame[6:] == bytes.fromhex("01 17 0003 0006 000E 0003 06 00FF 00FF 00FF")
    assert request.reply_size == 7 + 14
    assert request.reply_head[4:] == bytes.fromhex("000F 01 17 0C")


def test_the_read_request_equals_the_example_of_the_specification():
    """MODBUS Application Protocol 1.1b3, 6.3: registers 108 to 110."""
    request = read_request("rtu", 17, 3, 107, 3)
    assert request.frame == crc(bytes.fromhex("11 03 006B 0003"))
    assert request.reply_head == bytes.fromhex("11 03 06")
    assert request.reply_size == 11


def test_the_write_request_equals_the_example_of_the_specification():
    """MODBUS Application Protocol 1.1b3, 6.12: two registers from 2."""
    request = write_request("tcp", 1, 16, 1, 2)
    struct.pack_into(">HH", request.frame, request.values_at, 0x000A, 0x0102)
    assert request.frame[7:] == bytes.fromhex("10 0001 0002 04 000A 0102")
    assert request.reply_head[7:] == bytes.fromhex("10 0001 0002")


def test_the_single_register_write_expects_its_value_in_the_reply():
    """MODBUS Application Protocol 1.1b3, 6.6: register 2 becomes 3."""
    request = write_request("tcp", 1, 6, 1, 1)
    struct.pack_into(">H", request.frame, request.values_at, 3)
    request.mirror_values()
    assert request.frame[7:] == request.reply_head[7:] == bytes.fromhex("06 0001 0003")


@given(st.binary(min_size=1, max_size=260))
def test_the_checksum_equals_the_algorithm_of_the_specification(data):
    assert crc(data)[-2:] == struct.pack("<H", crc16(memoryview(data)))
    assert crc16(memoryview(crc(data))) == 0


def force_and_voltage(**more):
    return rtu_config("/dev/none", registers=registers(without=FORCE_ONLY), **more)


@pytest.mark.parametrize(("baudrate", "rate_Hz"), [(115200, 349), (921600, 2793)])
def test_the_rate_limit_of_two_floats_follows_from_characters_and_gaps(baudrate, rate_Hz):
    """26 bytes and two gaps of 3.5 characters, ten bits each."""
    assert round(max_wire_rate_Hz(force_and_voltage(baudrate=baudrate))) == rate_Hz


@pytest.mark.parametrize("baudrate", [115200, 921600, 3_000_000])
def test_with_the_fixed_gap_the_rate_limit_is_below_279_hertz(baudrate):
    rate_Hz = max_wire_rate_Hz(force_and_voltage(baudrate=baudrate, silent_interval="fixed"))
    assert rate_Hz == pytest.approx(1.0 / (260 / baudrate + 2 * 0.00175), rel=1e-12)
    assert rate_Hz < 279


def test_parity_and_a_second_transaction_lower_the_rate_limit():
    split = registers(16, 3, without=FORCE_ONLY)
    config = rtu_config("/dev/none", registers=split, baudrate=19200, parity="E")
    characters = (13 + 8) + (8 + 9) + 4 * 3.5
    assert max_wire_rate_Hz(config) == pytest.approx(19200 / 11 / characters)
    single = split | {
        "voltage_setpoint": {"address": 0, "function": 6, "type": "int16", "unit": "V"},
        "force": {"address": 0, "function": 4, "type": "int16", "unit": "N"},
    }
    config = rtu_config("/dev/none", registers=single, baudrate=19200)
    assert max_wire_rate_Hz(config) == pytest.approx(19200 / 10 / ((8 + 8) + (8 + 7) + 4 * 3.5))


def test_tcp_has_no_rate_limit():
    assert max_wire_rate_Hz(tcp_config(502)) is None


def test_the_rate_limit_of_lines_uses_their_shortest_form():
    config = line_config("/dev/none", baudrate=9600)
    sent, received = len("SET 0.000\nGET\n"), len("123\n")
    assert max_wire_rate_Hz(config) == pytest.approx(9600 / 10 / (sent + received))
