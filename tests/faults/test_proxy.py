"""The proxy applies its rules to the named frames and lists its actions."""

import asyncio
import contextlib
import struct

import pytest

from tests.faults.forgeries import KINDS, MARK_N, ON_RTU, ON_TCP, crc, forged
from tests.faults.proxy import Rule, TcpProxy


def frame(transaction, pdu=b"\x03\x02\x00\x2a"):
    return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, 1) + pdu


async def device(reader, writer):
    """Echo every frame."""
    try:
        with contextlib.suppress(OSError):
            while data := await reader.read(4096):
                writer.write(data)
    finally:
        writer.transport.abort()


def through(rules, talk):
    """Run `talk(proxy, reader, writer)` with an echoing device behind a proxy with these rules."""

    async def run():
        server = await asyncio.start_server(device, "127.0.0.1", 0)
        proxy = TcpProxy(server.sockets[0].getsockname()[:2])
        port = await proxy.open()
        proxy.schedule([Rule(**rule) for rule in rules])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        try:
            return await talk(proxy, reader, writer), proxy.done
        finally:
            writer.transport.abort()
            await proxy.close()
            server.close()
            others = asyncio.all_tasks() - {asyncio.current_task()}
            await asyncio.gather(*others, return_exceptions=True)

    return asyncio.run(run())


def sending(count, wait_s=0.15):
    async def talk(_proxy, reader, writer):
        got = b""
        for k in range(count):
            writer.write(frame(k + 1))
            try:
                async with asyncio.timeout(wait_s):
                    got += await reader.read(4096)
            except (TimeoutError, ConnectionResetError):
                got += b"|"
        return got

    return talk


@pytest.mark.parametrize(
    ("rules", "count", "expected", "done"),
    [
        ([], 2, frame(1) + frame(2), []),
        ([{"do": "duplicate"}], 1, frame(1) * 2, ["duplicate"]),
        ([{"do": "duplicate", "after": 1}], 3, frame(1) + frame(2) * 2 + frame(3), ["duplicate"]),
    ],
)
def test_rule_acts_on_its_frames_only(rules, count, expected, done):
    assert through(rules, sending(count)) == (expected, done)


def test_a_split_frame_arrives_whole_and_a_corrupt_one_differs_in_one_bit():
    async def talk(_proxy, reader, writer):
        writer.write(frame(1))
        return await reader.readexactly(len(frame(1)))

    assert through([{"do": "split"}], talk)[0] == frame(1)
    wire = TcpProxy(("127.0.0.1", 0))
    splits = [wire._split(frame(1)) for _ in frame(1)]
    assert all(b"".join(segments) == frame(1) and all(segments) for segments in splits)
    boundaries = {sum(map(len, segments[:k])) for segments in splits for k in range(1, len(segments))}
    assert boundaries == set(range(1, len(frame(1))))
    corrupt = through([{"do": "corrupt"}], talk)[0]
    assert sum((a ^ b).bit_count() for a, b in zip(corrupt, frame(1), strict=True)) == 1


def test_proxy_refuses_connections_until_it_is_restored():
    async def talk(proxy, _reader, _writer):
        await proxy.act("refuse")
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection(*proxy._address)
        await proxy.act("restore")
        reader, writer = await asyncio.open_connection(*proxy._address)
        writer.write(frame(9))
        got = await reader.read(4096)
        writer.close()
        return got

    assert through([], talk)[0] == frame(9)


def test_an_unknown_rule_is_refused():
    with pytest.raises(ValueError, match="must be one of"):
        Rule("explode")


PDU = b"\x17\x0e" + struct.pack(">ffHHH", 1.0, 2.0, 7, 3, 1)
BEFORE = b"\x17\x0e" + struct.pack(">ffHHH", 0.5, 1.0, 6, 2, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_false_reply_carries_the_marked_force_and_differs_from_the_good_one(kind):
    if kind in ON_TCP:
        good, before = frame(5, PDU), frame(4, BEFORE)
        made = forged(kind, good, before, 0, framing="tcp")
        assert made != good
        assert kind == "late_reply" or struct.pack(">f", MARK_N) in made
    if kind in ON_RTU:
        good, before = crc(b"\1" + PDU), crc(b"\1" + BEFORE)
        made = forged(kind, good, before, 0, framing="rtu")
        assert made != good
        assert (crc(made[:-2]) == made) is (kind != "bad_crc")
