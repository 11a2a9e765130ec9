"""An invalid reply names its cause where its bytes show it."""

import struct

import pytest

from piezod.errors import ConfigurationError
from piezod.transport import ExchangeResult
from tests.unit.transport.conftest import connected
from tests.unit.transport.garbled import bit_flipped
from tests.unit.transport.scripted import crc


def tcp_frame(body):
    return struct.pack(">HHH", 1, 0, len(body)) + body


CHANGES = {
    "own number": ("tcp", lambda reply: b"\x70\x01" + reply[2:], "numbers replies by itself"),
    "number zero": ("tcp", lambda reply: b"\0\0" + reply[2:], "numbers replies by itself"),
    "RTU on a link of TCP": ("tcp", lambda reply: crc(reply[6:]), "set link.kind to rtu_over_tcp"),
    "text": ("tcp", lambda _: b"HTTP/1.1 400 Bad Request\r\n\r\n", "another service uses this port"),
    "TCP on a link of RTU over TCP": ("gateway", lambda reply: tcp_frame(reply[:-2]), "set link.kind to modbus_tcp"),
    "a byte before": ("rtu", lambda reply: b"\x00" + reply, "1 byte before it, 00: check bias"),
    "two bytes before": ("rtu", lambda reply: b"\xff\x00" + reply, "2 bytes before it, ff 00: check bias"),
    "a byte before, gateway": ("gateway", lambda reply: b"\xf0" + reply, "1 byte before it, f0: check bias"),
}


@pytest.mark.parametrize(("wire", "change", "words"), CHANGES.values(), ids=CHANGES)
def test_a_set_up_exchange_names_the_cause_that_the_bytes_show(wire, change, words):
    with connected(wire) as (link, server):
        link.close()
        server.answer = lambda frame, _number: [change(server.good(frame))]
        link.open()
        with pytest.raises(ConfigurationError, match=words):
            link.identify()


def test_a_modbus_exception_in_an_rtu_frame_is_named_though_it_is_shorter_than_a_tcp_header():
    with connected("tcp") as (link, server):
        link.close()
        server.answer = lambda frame, _number: [crc(bytes((frame[6], frame[7] | 0x80, 2)))]
        link.open()
        assert link.exchange(1.0) is ExchangeResult.TIMEOUT
        assert "set link.kind to rtu_over_tcp" in link.hint


def test_a_good_exchange_removes_the_cause():
    with connected("tcp") as (link, server):
        link.close()
        server.once(lambda frame: [crc(server.good(frame)[6:])])
        link.open()
        link.exchange(1.0)
        assert link.hint
        while link.exchange(1.0) is not ExchangeResult.OK:
            pass
        assert link.hint == ""


@pytest.mark.parametrize("wire", ["tcp", "rtu", "gateway"])
def test_other_damage_has_no_such_cause(wire):
    with connected(wire) as (link, server):
        server.answer = lambda frame, _number: bit_flipped(server.good(frame))
        link.exchange(1.0)
        assert link.hint == ""
