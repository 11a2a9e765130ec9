"""False replies that a link must reject, made from good replies; most carry the marked force `MARK_N`.

::

    TCP  [ tid | protocol 0 | length | unit ][ function | byte count | registers ]
    RTU                               [ unit ][ function | byte count | registers ][ CRC ]
"""

import struct

MARK_N = 555.0  # within the range of the register map, far from the forces of the bench
FORCE_AT = 2  # in the protocol data unit: after function and byte count
HEARTBEAT_AT = 10  # after force and voltage
ECHO_AT = 12

KINDS = {
    "wrong_transaction": "another transaction id",
    "transaction_zero": "transaction id 0",
    "wrong_unit": "another unit",
    "wrong_function": "another function",
    "fewer_registers": "one register less",
    "more_registers": "one register more",
    "byte_count": "a byte count unequal to the payload",
    "odd_byte_count": "an odd number of bytes",
    "length": "MBAP length 0, 1, 65535",
    "protocol_id": "a protocol id that is not 0",
    "late_reply": "the reply to the previous request",
    "stale_heartbeat": "an unchanged heartbeat",
    "exception_as_data": "an exception's function code before registers",
    "bad_crc": "a wrong checksum",
}
ON_TCP = tuple(kind for kind in KINDS if kind != "bad_crc")
ON_RTU = tuple(kind for kind in KINDS if kind not in ("wrong_transaction", "transaction_zero", "length", "protocol_id"))
LENGTHS = (0, 1, 65535)


def crc(data: bytes) -> bytes:
    """The data with its checksum (MODBUS over Serial Line 1.02, 6.2.2), bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return data + struct.pack("<H", value)


def with_force(pdu: bytes, force_N: float = MARK_N) -> bytes:
    """A protocol data unit with another force; a unit that is too short is returned unchanged."""
    if len(pdu) < FORCE_AT + 4:
        return pdu
    return pdu[:FORCE_AT] + struct.pack(">f", force_N) + pdu[FORCE_AT + 4 :]


def forged(kind: str, good: bytes, before: bytes, number: int, *, framing: str) -> bytes:
    """A false reply of the given kind.

    Parameters
    ----------
    kind
        One of `KINDS`.
    good
        The good reply, as a whole frame.
    before
        The good reply to the previous request.
    number
        Index of the false reply; selects a variant in turn.
    framing
        `tcp` or `rtu`.
    """
    if kind == "late_reply":
        return before
    head, pdu = _parts(good, framing)
    marked = with_force(pdu)
    if kind == "stale_heartbeat":
        stale = _parts(before, framing)[1]
        marked = marked[:HEARTBEAT_AT] + stale[HEARTBEAT_AT : HEARTBEAT_AT + 2] + marked[HEARTBEAT_AT + 2 :]
    transaction, unit = head
    changed = _CHANGES.get(kind, lambda data: data)(marked)
    if kind == "wrong_unit":
        unit = unit % 247 + 1
    if framing == "rtu":
        frame = crc(bytes((unit,)) + changed)
        return frame[:-1] + bytes((frame[-1] ^ 0x5A,)) if kind == "bad_crc" else frame
    transaction = {"wrong_transaction": (transaction + 7) % 65536, "transaction_zero": 0}.get(kind, transaction)
    length = LENGTHS[number % len(LENGTHS)] if kind == "length" else len(changed) + 1
    return struct.pack(">HHHB", transaction, int(kind == "protocol_id"), length, unit) + changed


def _parts(frame: bytes, framing: str) -> tuple[tuple[int, int], bytes]:
    """Transaction id and unit, and the protocol data unit."""
    if framing == "tcp":
        return (struct.unpack_from(">H", frame)[0], frame[6]), frame[7:]
    return (0, frame[0]), frame[1:-2]


_CHANGES = {
    "wrong_function": lambda pdu: bytes((4 if pdu[0] == 3 else 3,)) + pdu[1:],
    "fewer_registers": lambda pdu: bytes((pdu[0], pdu[1] - 2)) + pdu[2:-2],
    "more_registers": lambda pdu: bytes((pdu[0], pdu[1] + 2)) + pdu[2:] + b"\0\7",
    "byte_count": lambda pdu: bytes((pdu[0], pdu[1] - 2)) + pdu[2:],
    "odd_byte_count": lambda pdu: bytes((pdu[0], pdu[1] - 1)) + pdu[2:-1],
    "exception_as_data": lambda pdu: bytes((pdu[0] | 0x80,)) + pdu[1:],
}
