"""Changes of a valid Modbus reply; each function returns a function from the reply to the parts that are sent.

The body of a reply is unit, function and data, the same on both wires::

    tcp   [ transaction, protocol, length: 6 bytes ][ body ]
    rtu, gateway                                    [ body ][ CRC: 2 bytes ]
"""

import struct

from tests.unit.transport.scripted import crc

DATA = 3  # index of the first register in the body, after unit, function and byte count


def with_body(wire, change):
    """Change the body, and correct length or checksum."""

    def changed(reply):
        if wire != "tcp":
            return [crc(change(reply[:-2]))]
        body = change(reply[6:])
        return [reply[:4] + struct.pack(">H", len(body)) + body]

    return changed


def overwritten(at, value):
    """Overwrite bytes, starting at index `at`."""
    return lambda data: data[:at] + value + data[at + len(value) :]


def resized(more):
    """Add registers at the end of a body, or remove them, with the byte count that belongs to them."""

    def change(body):
        data = (body[DATA:] + bytes(2 * max(0, more)))[: len(body) - DATA + 2 * more]
        return body[:2] + bytes((len(data),)) + data

    return change


def exception(code):
    """Body of a Modbus exception."""
    return lambda body: bytes((body[0], body[1] | 0x80, code))


def raw(at, value):
    """Overwrite bytes of the whole reply, without any correction."""
    change = overwritten(at, value)
    return lambda reply: [change(reply)]


def bit_flipped(reply):
    """Flip one bit of the data, without correcting the checksum."""
    return [reply[:5] + bytes((reply[5] ^ 4,)) + reply[6:]]
