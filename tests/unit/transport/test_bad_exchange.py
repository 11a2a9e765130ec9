"""The bytes of the last failed exchange: those that went over the wire, and none in the good path."""

from datetime import UTC, datetime, timedelta

import pytest

from piezod.session.session import BAD_EXCHANGE_BYTES
from piezod.transport import ExchangeResult, make_link
from piezod.transport.bad_exchange import KEPT_BYTES, SIZE, BadExchange, read_bad_exchange
from tests.unit.transport.conftest import MODBUS_WIRES, tcp_config
from tests.unit.transport.garbled import DATA, bit_flipped, exception, overwritten, with_body
from tests.unit.transport.scripted import CLOSE, ScriptedTcp


def observed(pair, change):
    """Result of an exchange whose reply is changed; request and reply as the device saw them; what was kept."""
    link, server = pair
    cells, seen = bytearray(SIZE), []
    link.keep_bad_exchange_in(cells)

    def answer(frame):
        seen.append(frame)
        parts = change(server.good(frame))
        seen.append(b"".join(part for part in parts if isinstance(part, bytes)))
        return parts

    server.once(answer)
    return link.exchange(7.0), *seen, read_bad_exchange(cells)


CASES = {
    ("rtu", "bad CRC"): (bit_flipped, "bad_crc"),
    ("gateway", "bad CRC"): (bit_flipped, "bad_crc"),
    ("tcp", "short frame"): (lambda reply: [reply[:11]], "timeout"),
    ("rtu", "short frame"): (lambda reply: [reply[:9]], "timeout"),
    ("gateway", "short frame, then closed"): (lambda reply: [reply[:9], CLOSE], "disconnected"),
    ("tcp", "no reply"): (lambda _reply: [], "timeout"),
    ("tcp", "another transaction"): (lambda reply: [b"\x70\x00" + reply[2:]], "wrong_transaction"),
} | {
    (wire, name): (with_body(wire, change), result)
    for wire in MODBUS_WIRES
    for name, change, result in (
        ("wrong function", overwritten(1, b"\3"), "wrong_function"),
        ("exception", exception(2), "device_exception"),
        ("heartbeat stood", overwritten(DATA + 8, b"\0\1"), "heartbeat_stood"),
    )
}


@pytest.mark.parametrize(("wire", "name"), CASES)
def test_request_and_reply_are_kept_as_they_went_over_the_wire(request, wire, name):
    change, expected = CASES[wire, name]
    result, sent, answered, kept = observed(request.getfixturevalue(wire), change)
    assert kept is not None
    assert result is not ExchangeResult.OK
    assert kept["result"] == result.name.lower() == expected
    assert bytes.fromhex(kept["reply"]) == answered
    assert kept["reply_bytes"] == len(answered)
    assert bytes.fromhex(kept["request"]) == sent
    assert kept["count"] == 1
    assert kept["link"] == "link"
    age = datetime.now(UTC) - datetime.fromisoformat(str(kept["time"]))
    assert timedelta() <= age + timedelta(milliseconds=1) < timedelta(seconds=30)


def test_the_line_with_the_unexpected_answer_is_kept(line):
    link, server = line
    cells = bytearray(SIZE)
    link.keep_bad_exchange_in(cells)
    server.answer = lambda frame, _number: [b"ERROR 5\n" if frame.startswith(b"GET") else server.good(frame)]
    assert link.exchange(7.0) is ExchangeResult.MALFORMED
    kept = read_bad_exchange(cells)
    assert kept is not None
    assert (bytes.fromhex(kept["request"]), bytes.fromhex(kept["reply"])) == (b"GET\n", b"ERROR 5\n")


@pytest.mark.parametrize("wire", [*MODBUS_WIRES, "line"])
def test_a_good_exchange_does_not_touch_the_memory(request, wire):
    link, _ = request.getfixturevalue(wire)
    cells = bytearray(SIZE)
    link.keep_bad_exchange_in(cells)
    for tick in range(10):
        assert link.exchange(float(tick)) is ExchangeResult.OK
    assert not any(cells)
    assert read_bad_exchange(cells) is None


def test_the_load_cell_of_a_pair_is_named():
    with ScriptedTcp() as amplifier, ScriptedTcp() as cell:
        link = make_link(tcp_config(amplifier.port), tcp_config(cell.port))
        cells = bytearray(SIZE)
        link.keep_bad_exchange_in(cells)
        link.open()
        assert link.exchange(0.0) is ExchangeResult.OK
        cell.once(lambda frame: [cell.good(frame)[:10]])
        assert link.exchange(1.0) is ExchangeResult.TIMEOUT
        kept = read_bad_exchange(cells)
        assert kept is not None
        assert (kept["link"], kept["result"], kept["reply_bytes"]) == ("load_cell_link", "timeout", 10)
        link.close()


def test_a_longer_reply_is_cut_and_its_length_stays():
    writer, cells = BadExchange(), bytearray(SIZE)
    writer.use(cells, 0)
    writer.keep(ExchangeResult.MALFORMED, b"\1\2", bytes(range(256)) * 4, 1024)
    kept = read_bad_exchange(cells)
    assert kept is not None
    assert (kept["request"], kept["reply_bytes"]) == ("01 02", 1024)
    assert bytes.fromhex(str(kept["reply"])) == (bytes(range(256)) * 2)[:KEPT_BYTES]


def test_the_parent_reserves_the_memory_that_a_link_writes():
    assert BAD_EXCHANGE_BYTES == SIZE
