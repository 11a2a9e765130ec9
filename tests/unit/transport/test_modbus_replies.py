"""Invalid, late and random replies, on both Modbus wires: none is used, and the next valid reply is accepted."""

import random
import struct
import time

import pytest

from piezod.transport import ExchangeResult
from tests.unit.transport import garbled
from tests.unit.transport.conftest import MODBUS_WIRES, TIMEOUT_S, connected
from tests.unit.transport.garbled import DATA, exception, overwritten, resized
from tests.unit.transport.scripted import CLOSE, RESET, registers, snapshot, until_good

UNNUMBERED = ("heartbeat", "command_echo", "command_sequence")

BODIES = {
    "another unit": (overwritten(0, b"\2"), ExchangeResult.WRONG_UNIT),
    "another function": (overwritten(1, b"\3"), ExchangeResult.WRONG_FUNCTION),
    "byte count above the payload": (overwritten(2, b"\x10"), ExchangeResult.WRONG_COUNT),
    "odd byte count": (overwritten(2, b"\x0d"), ExchangeResult.WRONG_COUNT),
    "one register more": (resized(1), ExchangeResult.WRONG_COUNT),
    "one register fewer": (resized(-1), ExchangeResult.WRONG_COUNT),
    "exception 2": (exception(2), ExchangeResult.DEVICE_EXCEPTION),
    "exception 4": (exception(4), ExchangeResult.DEVICE_EXCEPTION),
    "force not a number": (overwritten(DATA, struct.pack(">f", float("nan"))), ExchangeResult.NOT_FINITE),
    "force infinite": (overwritten(DATA, struct.pack(">f", float("-inf"))), ExchangeResult.NOT_FINITE),
    "force above high": (overwritten(DATA, struct.pack(">f", 1000.5)), ExchangeResult.OUT_OF_RANGE),
    "heartbeat unchanged": (overwritten(DATA + 8, struct.pack(">H", 1)), ExchangeResult.HEARTBEAT_STOOD),
    "heartbeat backwards": (overwritten(DATA + 8, struct.pack(">H", 0)), ExchangeResult.HEARTBEAT_STOOD),
    "echo of the previous command": (overwritten(DATA + 10, struct.pack(">H", 1)), ExchangeResult.ECHO_MISMATCH),
}
FRAMES = {
    ("tcp", "transaction of another request"): (garbled.raw(0, b"\x70\x00"), ExchangeResult.WRONG_TRANSACTION),
    ("tcp", "transaction zero"): (garbled.raw(0, b"\0\0"), ExchangeResult.WRONG_TRANSACTION),
    ("tcp", "protocol one"): (garbled.raw(2, b"\0\1"), ExchangeResult.MALFORMED),
    ("tcp", "length zero"): (garbled.raw(4, b"\0\0"), ExchangeResult.MALFORMED),
    ("tcp", "length one"): (garbled.raw(4, b"\0\1"), ExchangeResult.MALFORMED),
    ("tcp", "length 65535"): (garbled.raw(4, b"\xff\xff"), ExchangeResult.MALFORMED),
    ("tcp", "half a reply"): (lambda reply: [reply[:11]], ExchangeResult.TIMEOUT),
    ("tcp", "no reply"): (lambda _reply: [], ExchangeResult.TIMEOUT),
    ("tcp", "half a reply, then closed"): (lambda reply: [reply[:11], CLOSE], ExchangeResult.DISCONNECTED),
    ("tcp", "closed"): (lambda _reply: [CLOSE], ExchangeResult.DISCONNECTED),
    ("tcp", "reset"): (lambda _reply: [RESET], ExchangeResult.DISCONNECTED),
    ("rtu", "a bit flipped"): (garbled.bit_flipped, ExchangeResult.BAD_CRC),
    ("rtu", "noise before"): (lambda reply: [b"\xff\x00", reply], ExchangeResult.BAD_CRC),
    ("rtu", "half a reply"): (lambda reply: [reply[:9]], ExchangeResult.TIMEOUT),
    ("rtu", "no reply"): (lambda _reply: [], ExchangeResult.TIMEOUT),
    ("gateway", "a bit flipped"): (garbled.bit_flipped, ExchangeResult.BAD_CRC),
    ("gateway", "half a reply"): (lambda reply: [reply[:9]], ExchangeResult.TIMEOUT),
    ("gateway", "no reply"): (lambda _reply: [], ExchangeResult.TIMEOUT),
    ("gateway", "half a reply, then closed"): (lambda reply: [reply[:9], CLOSE], ExchangeResult.DISCONNECTED),
    ("gateway", "closed"): (lambda _reply: [CLOSE], ExchangeResult.DISCONNECTED),
    ("gateway", "reset"): (lambda _reply: [RESET], ExchangeResult.DISCONNECTED),
}
GARBLED = FRAMES | {
    (wire, name): (garbled.with_body(wire, change), result)
    for wire in MODBUS_WIRES
    for name, (change, result) in BODIES.items()
}


@pytest.mark.parametrize(("wire", "name"), GARBLED)
def test_a_garbled_reply_is_not_used_and_the_next_reply_is_accepted(request, wire, name):
    link, server = request.getfixturevalue(wire)
    change, expected = GARBLED[wire, name]
    before = snapshot(link.reading)
    server.once(lambda frame: change(server.good(frame)))
    assert link.exchange(7.0) is expected
    assert snapshot(link.reading) == before
    assert link.counts[expected] == 1
    until_good(lambda: link.exchange(8.0))
    assert link.reading.force_N == 16.0


@pytest.mark.parametrize("wire", MODBUS_WIRES)
def test_a_reply_in_single_bytes_is_accepted(request, wire):
    link, server = request.getfixturevalue(wire)
    server.once(lambda frame: [part for byte in server.good(frame) for part in (bytes((byte,)), 0.0005)])
    assert link.exchange(3.0) is ExchangeResult.OK
    assert link.reading.force_N == 6.0


@pytest.mark.parametrize(("wire", "delay"), [("tcp", 1.3), ("rtu", 1.2), ("rtu", 1.6), ("rtu", 1.9), ("gateway", 1.6)])
def test_a_late_reply_is_never_used_for_the_next_request(wire, delay):
    with connected(wire, registers=registers(without=UNNUMBERED)) as (link, server):
        server.once(lambda frame: [delay * TIMEOUT_S, server.good(frame)])
        assert link.exchange(5.0) is ExchangeResult.TIMEOUT
        results = until_good(lambda: link.exchange(6.0))
        assert link.reading.force_N == 12.0
        if wire == "tcp":
            assert server.connections == 2
        else:
            assert set(results) == {ExchangeResult.DISCONNECTED, ExchangeResult.OK}


@pytest.mark.parametrize(
    ("wire", "write", "rejections"),
    [
        ("tcp", 23, {ExchangeResult.WRONG_TRANSACTION}),
        ("rtu", 23, {ExchangeResult.ECHO_MISMATCH}),
        ("gateway", 23, {ExchangeResult.ECHO_MISMATCH}),
        ("rtu", 16, {ExchangeResult.ECHO_MISMATCH, ExchangeResult.WRONG_FUNCTION, ExchangeResult.WRONG_COUNT}),
    ],
)
def test_replies_that_are_always_late_by_one_request_are_never_used(wire, write, rejections):
    without_identity = {"identity": None, "order_check": None}  # its late replies would be refused before any echo
    functions = registers(write, 23 if write == 23 else 3, without=("heartbeat",)) | without_identity
    with connected(wire, registers=functions, timeout_s=0.02) as (link, server):
        replies = []

        def answer(frame, _number):
            replies.append(server.good(frame))
            return [replies[-2]] if len(replies) > 1 else []

        server.answer = answer
        results = set()
        for tick in range(40):
            results.add(link.exchange(float(tick)))
            time.sleep(0.005)
        assert ExchangeResult.OK not in results
        assert results & rejections


@pytest.mark.parametrize("wire", MODBUS_WIRES)
def test_random_bytes_never_raise_and_are_never_used(request, wire):
    link, server = request.getfixturevalue(wire)
    source = random.Random(21)
    server.answer = lambda _frame, _number: [source.randbytes(source.randrange(1, 300))]
    before = snapshot(link.reading)
    link._timeout_s = 0.01
    for _ in range(60):
        assert link.exchange(1.0) is not ExchangeResult.OK
        if wire == "tcp":
            link._wire._not_before_s = 0.0
        else:
            link._wire._port._settled_at_s = 0.0
    assert snapshot(link.reading) == before
