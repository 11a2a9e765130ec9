"""Causes of invalid replies that their bytes show: another framing, another numbering, bytes before the reply."""

from piezod.transport.frames import CRC_BYTES, MBAP_BYTES, Request, crc16
from piezod.transport.link import ExchangeResult

SHORTEST_FRAME_BYTES = 5  # a Modbus exception: unit, function, code, CRC
MOST_BYTES_BEFORE = 4  # bytes before a reply; an edge of the line without bias gives one or two
TRANSACTION_BYTES = 2


def tcp_hint(result: ExchangeResult, reply: memoryview, request: Request) -> str:
    """Cause of the failure of a link modbus_tcp; empty: the bytes show none.

    Parameters
    ----------
    result
        Classified failure.
    reply
        Received bytes.
    request
        Transmitted request.
    """
    unit_and_function = bytes(request.reply_head[MBAP_BYTES - 1 : MBAP_BYTES + 1])
    if result is ExchangeResult.WRONG_TRANSACTION:
        if bytes(reply[TRANSACTION_BYTES : len(request.reply_head)]) != request.reply_head[TRANSACTION_BYTES:]:
            return ""
        sent, found = (int.from_bytes(frame[:TRANSACTION_BYTES], "big") for frame in (request.frame, reply))
        return (
            f"the reply to transaction {sent} has the number {found}: the gateway numbers replies by itself; "
            "update or replace it, or use its port of link.kind rtu_over_tcp"
        )
    if len(reply) >= SHORTEST_FRAME_BYTES and crc16(reply) == 0 and reply[0] == unit_and_function[0]:
        return "the reply is a frame of Modbus RTU: set link.kind to rtu_over_tcp"
    if len(reply) >= SHORTEST_FRAME_BYTES and all(32 <= byte < 127 or byte in b"\r\n\t" for byte in reply):
        return f"the reply is text, {bytes(reply[:20])!r}: another service uses this port"
    return ""


def rtu_hint(reply: memoryview, request: Request) -> str:
    """Cause of a wrong checksum of a link modbus_rtu or rtu_over_tcp; empty: the bytes show none.

    Parameters
    ----------
    reply
        Received bytes.
    request
        Transmitted request.
    """
    for extra in range(1, MOST_BYTES_BEFORE + 1):
        frame = reply[extra:]
        if len(frame) < SHORTEST_FRAME_BYTES:
            break
        if frame[0] == request.reply_head[0] and crc16(frame) == 0:
            before = f"{extra} byte{'s' * (extra > 1)} before it, {bytes(reply[:extra]).hex(' ')}"
            return f"the reply is right but for {before}: check bias, termination and ground of the RS-485 line"
    has_tcp_head = len(reply) > MBAP_BYTES + CRC_BYTES and not reply[2] and not reply[3]
    if has_tcp_head and 6 + int.from_bytes(reply[4:6], "big") == len(reply) and reply[6] == request.reply_head[0]:
        return "the reply is a frame of Modbus TCP: set link.kind to modbus_tcp"
    return ""
