"""Registers and blocks of registers: encoding, decoding and checks."""

import struct
from math import isnan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import ModbusTcpClient

from piezod.config.link import Register
from piezod.errors import ConfigurationError
from piezod.runtime import clock
from piezod.transport import ExchangeResult
from piezod.transport.frames import write_request
from piezod.transport.registers import RegisterCodec
from piezod.transport.tick_values import COUNTERS, QUANTITIES, Plausibility, ReadBlock, SetPoint

TYPE = ModbusTcpClient.DATATYPE
PYMODBUS = {"int16": TYPE.INT16, "uint16": TYPE.UINT16, "int32": TYPE.INT32, "float32": TYPE.FLOAT32}
RANGES = {"int16": (-32768, 32767), "uint16": (0, 65535), "int32": (-(2**31), 2**31 - 1)}
ORDERS = {"int16": ("AB", "BA"), "uint16": ("AB", "BA"), "int32": ("ABCD", "CDAB", "BADC", "DCBA")}
ORDERS["float32"] = ORDERS["int32"]
KINDS = [(kind, order) for kind, orders in ORDERS.items() for order in orders]


def register(kind, order=None, **more):
    return Register.model_validate({"address": 0, "type": kind, "order": order} | more)


def by_pymodbus(kind, order, raw):
    """pymodbus orders the words; this function swaps the bytes in a word."""
    first = order in ("AB", "BA", "ABCD", "BADC")
    words = ModbusTcpClient.convert_to_registers(raw, PYMODBUS[kind], word_order="big" if first else "little")
    swapped = order in ("BA", "BADC", "DCBA")
    return b"".join(struct.pack("<H" if swapped else ">H", word) for word in words)


def raw_values(kind):
    if kind == "float32":
        return st.floats(width=32, allow_nan=False, allow_infinity=False)
    return st.integers(*RANGES[kind])


@pytest.mark.parametrize(("kind", "order"), KINDS)
@given(data=st.data())
def test_the_bytes_equal_those_of_pymodbus(kind, order, data):
    raw = data.draw(raw_values(kind))
    buffer = bytearray(8)
    codec = RegisterCodec(register(kind, order))
    assert codec.pack_into(buffer, 2, float(raw)) == raw
    assert bytes(buffer[2 : 2 + codec.size]) == by_pymodbus(kind, order, raw)
    assert codec.unpack_from(buffer, 2) == raw


@given(
    kind=st.sampled_from(sorted(RANGES)),
    scale=st.floats(1e-4, 1e3) | st.floats(-1e3, -1e-4),
    offset=st.floats(-1e3, 1e3),
    data=st.data(),
)
def test_the_decoded_value_is_within_half_a_count(kind, scale, offset, data):
    low, high = RANGES[kind]
    value = data.draw(st.floats(low, high)) * scale + offset
    codec = RegisterCodec(register(kind, scale=scale, offset=offset))
    buffer = bytearray(4)
    written = codec.pack_into(buffer, 0, value)
    if not isnan(written):
        assert abs(written - value) <= 0.5 * abs(scale) + 1e-9 * abs(value)
        assert codec.unpack_from(buffer, 0) == written


@pytest.mark.parametrize(
    ("kind", "value"),
    [("uint16", -1.0), ("uint16", 65535.6), ("int16", 32768.0), ("int32", 2.0**31), ("float32", 3.5e38),
     ("float32", float("nan")), ("uint16", float("inf")), ("int32", float("nan"))],
)  # fmt: skip
def test_a_value_that_does_not_fit_is_not_saturated_and_leaves_the_buffer(kind, value):
    buffer = bytearray(b"same")
    assert isnan(RegisterCodec(register(kind)).pack_into(buffer, 0, value))
    assert buffer == b"same"


def test_low_and_high_of_a_register_bound_the_written_value():
    codec = RegisterCodec(register("float32", low=0.0, high=10.0))
    assert isnan(codec.pack_into(bytearray(4), 0, 10.5))
    assert codec.pack_into(bytearray(4), 0, 10.0) == 10.0


def test_a_limit_that_cannot_be_encoded_is_refused_with_its_name():
    codec = RegisterCodec(register("uint16", scale=0.001))
    codec.check_encodable(0.0, 65.0, "link")
    with pytest.raises(ConfigurationError, match=r"link: 140 cannot be encoded, must be within 0 and 65\.535"):
        codec.check_encodable(0.0, 140.0, "link")


@given(data=st.data())
def test_a_block_decodes_like_its_single_registers(data):
    """Any types and orders, with gaps."""
    members, address = {}, data.draw(st.integers(0, 100))
    for role in ("force", "voltage_readback", "temperature", "reference"):
        kind, order = data.draw(st.sampled_from(KINDS))
        unit = {"force": "N", "reference": "N", "voltage_readback": "V", "temperature": "degC"}[role]
        address += data.draw(st.integers(0, 3))
        members[role] = register(
            kind, order, address=address, scale=data.draw(st.sampled_from([1.0, 0.1, -2.0])), unit=unit
        )
        address += members[role].words
    block = ReadBlock(members)
    payload = bytearray(data.draw(st.binary(min_size=5 + 2 * block.count, max_size=5 + 2 * block.count)))
    for member in members.values():
        RegisterCodec(member).pack_into(
            payload, 5 + 2 * (member.address - block.first), data.draw(st.integers(-300, 300)) * 0.1
        )
    values = [0.0] * len(QUANTITIES)
    result = block.decode(memoryview(payload), 5, values, [0] * len(COUNTERS))
    expected = {
        role: RegisterCodec(member).unpack_from(payload, 5 + 2 * (member.address - block.first))
        for role, member in members.items()
    }
    if result == 0:
        assert {role: values[QUANTITIES[role]] for role in members} == expected


@pytest.mark.parametrize("fields", [{"scale": 2.0}, {"offset": 1.0}, {"high": 9.0}, {"kind": "float32"}])
def test_a_counter_that_is_not_a_plain_integer_is_refused(fields):
    with pytest.raises(ConfigurationError, match=r"registers\.heartbeat.*it is a counter or status bits"):
        ReadBlock({"heartbeat": register(**({"kind": "uint16"} | fields))})


def test_a_heartbeat_may_stay_unchanged_for_the_configured_time_only(monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(clock, "monotonic", lambda: now_s)
    plausibility = Plausibility(frozenset({"heartbeat"}), heartbeat_within_s=0.005)
    results = []
    for heartbeat, at_s in ((7, 0.0), (8, 0.001), (8, 0.005), (8, 0.0061), (9, 0.007), (8, 0.008)):
        now_s = 100.0 + at_s
        plausibility.counters[0] = heartbeat
        results.append(plausibility.accept(-1))
    ok, stood = ExchangeResult.OK, ExchangeResult.HEARTBEAT_STOOD
    assert results == [ok, ok, ok, stood, ok, stood]


@pytest.mark.parametrize(("after_s", "good"), [(0.5, False), (4.9, False), (8.3, True), (12.0, True)])
def test_a_heartbeat_after_a_long_silence_is_accepted_wherever_it_stands(monkeypatch, after_s, good):
    """A counter of 4,000 samples a second passes half its range in 8.2 s: it has not gone backwards."""
    now_s = 100.0
    monkeypatch.setattr(clock, "monotonic", lambda: now_s)
    plausibility = Plausibility(frozenset({"heartbeat"}), heartbeat_within_s=0.005)
    plausibility.accept(-1)
    now_s += after_s
    plausibility.counters[0] = 40_000
    assert (plausibility.accept(-1) is ExchangeResult.OK) is good
    now_s += 0.001
    plausibility.counters[0] = 40_004
    assert (plausibility.accept(-1) is ExchangeResult.OK) is good


def test_a_standing_heartbeat_is_refused_after_any_time(monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(clock, "monotonic", lambda: now_s)
    plausibility = Plausibility(frozenset({"heartbeat"}), heartbeat_within_s=0.005)
    plausibility.accept(-1)
    now_s += 60.0
    assert plausibility.accept(-1) is ExchangeResult.HEARTBEAT_STOOD


def test_a_command_number_in_front_of_the_voltage_keeps_both_in_their_places():
    writes = {
        "command_sequence": register("uint16", address=30),
        "voltage_setpoint": register("float32", "ABCD", address=31),
    }
    request = write_request("tcp", 1, 16, 30, 3)
    set_point = SetPoint(writes)
    assert set_point.encode_into(request, 12.5) == 12.5
    at = request.values_at
    assert struct.unpack(">Hf", bytes(request.frame[at : at + 6])) == (set_point.sequence, 12.5)
    before = set_point.sequence
    set_point.encode_into(request, 13.0)
    assert struct.unpack(">Hf", bytes(request.frame[at : at + 6])) == ((before + 1) % 65536, 13.0)
