"""Modbus request templates with the expected reply, built once with the PDU and framer classes of pymodbus.

Each tick writes only value bytes, transaction id and CRC into the template::

    TCP  [ tid | 0 0 | length | unit ][ function | ... | values ]             tid: 2 bytes, request number
    RTU                       [ unit ][ function | ... | values ][ CRC ]      CRC: 2 bytes

    function 23:   read address | read count | write address | write count | byte count | values
        reply:     byte count | registers
    function 3, 4: address | count                          reply: byte count | registers
    function 16:   address | count | byte count | values    reply: address | count
    function 6:    address | value                          reply: address | value
"""

from typing import TYPE_CHECKING, Literal

from pymodbus.framer import FramerBase, FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadHoldingRegistersResponse,
    ReadInputRegistersRequest,
    ReadInputRegistersResponse,
    ReadWriteMultipleRegistersRequest,
    ReadWriteMultipleRegistersResponse,
    WriteMultipleRegistersRequest,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterRequest,
    WriteSingleRegisterResponse,
)

from piezod.transport.link import ExchangeResult

if TYPE_CHECKING:
    from collections.abc import Callable

Framing = Literal["tcp", "rtu"]

MBAP_BYTES = 7  # transaction id, protocol id, length, unit: MODBUS Messaging on TCP/IP 1.0b, 3.1.3
CRC_BYTES = 2
_CRC_TABLE = tuple(FramerRTU.crc16_table)


class Request:
    """One request frame, and the fixed part of its valid reply.

    Attributes
    ----------
    frame
        The complete request; value bytes, transaction id and CRC are overwritten in place.
    values_at
        Index of the first written value in `frame`; 0: the request writes nothing.
    reply_head
        First bytes of a valid reply: everything before registers and CRC.
    reply_size
        Length of a valid reply [bytes].
    payload_at
        Index of the first register in the reply.
    unit_at
        Index of the unit id in request and reply; the function code follows.
    reads
        Whether the reply contains registers.
    mirrors_values
        Whether the reply repeats the written value (function 6).
    values, checksum
        The variable bytes of `frame` before the CRC, and the checksum of the bytes before them.
    reply_fixed, reply_checksum
        Number of constant bytes at the start of a valid reply, and their checksum.
    """

    __slots__ = (
        "checksum",
        "frame",
        "mirrors_values",
        "payload_at",
        "reads",
        "reply_checksum",
        "reply_fixed",
        "reply_head",
        "reply_size",
        "unit_at",
        "values",
        "values_at",
    )

    def __init__(self, request: ModbusPDU, reply: ModbusPDU, *, framing: Framing, written: int, read: int) -> None:
        trailer = CRC_BYTES if framing == "rtu" else 0
        framer = _framer(framing)
        self.frame = bytearray(framer.buildFrame(request))
        whole_reply = framer.buildFrame(reply)
        self.reply_size = len(whole_reply)
        self.payload_at = self.reply_size - trailer - 2 * read
        self.reply_head = bytearray(whole_reply[: self.payload_at])
        self.values_at = len(self.frame) - trailer - 2 * written if written else 0
        self.unit_at = MBAP_BYTES - 1 if framing == "tcp" else 0
        self.mirrors_values = request.function_code == 6
        self.reads = read > 0
        end = len(self.frame) - trailer
        begin = self.values_at or end
        self.values = memoryview(self.frame)[begin:end]
        self.checksum = crc16(memoryview(self.frame)[:begin])
        self.reply_fixed = self.payload_at - 2 * self.mirrors_values
        self.reply_checksum = crc16(memoryview(self.reply_head)[: self.reply_fixed])

    def mirror_values(self) -> None:
        """Copy the value from `frame` into the expected reply."""
        self.reply_head[-2:] = self.frame[self.values_at : self.values_at + 2]


def crc16(frame: memoryview, checksum: int = 0xFFFF) -> int:
    """CRC-16 of the bytes, continued from `checksum`; 0 for a valid frame including its CRC.

    The table is from `FramerRTU` of pymodbus.
    """
    table = _CRC_TABLE
    for byte in frame:
        checksum = checksum >> 8 ^ table[(checksum ^ byte) & 255]
    return checksum


def classify(reply: bytearray, request: Request, size: int) -> tuple[ExchangeResult, int]:
    """Find the error in a complete frame that is not the valid reply to `request`.

    Parameters
    ----------
    reply
        Buffer that begins with the frame.
    size
        Length of the frame without CRC [bytes].

    Returns
    -------
    tuple
        Kind of error, and the Modbus exception code or 0.
    """
    unit_at, head = request.unit_at, request.reply_head
    if reply[unit_at] != head[unit_at]:
        return ExchangeResult.WRONG_UNIT, 0
    function, requested = reply[unit_at + 1], head[unit_at + 1]
    if function == requested | 0x80 and size == unit_at + 3:
        return ExchangeResult.DEVICE_EXCEPTION, reply[unit_at + 2]
    return (ExchangeResult.WRONG_COUNT if function == requested else ExchangeResult.WRONG_FUNCTION), 0


def read_request(framing: Framing, unit: int, function: int, address: int, count: int) -> Request:
    """Create a request that reads `count` registers by function 3 or 4."""
    input_registers = function == 4
    sent: Callable[..., ModbusPDU] = ReadInputRegistersRequest if input_registers else ReadHoldingRegistersRequest
    reply: Callable[..., ModbusPDU] = ReadInputRegistersResponse if input_registers else ReadHoldingRegistersResponse
    return Request(
        sent(dev_id=unit, address=address, count=count),
        reply(dev_id=unit, registers=[0] * count),
        framing=framing,
        written=0,
        read=count,
    )


def write_request(framing: Framing, unit: int, function: int, address: int, count: int) -> Request:
    """Create a request that writes `count` registers by function 16, or one register by function 6."""
    values = [0] * count
    if function == 6:
        single = WriteSingleRegisterRequest(dev_id=unit, address=address, registers=values)
        echo = WriteSingleRegisterResponse(dev_id=unit, address=address, registers=values)
        return Request(single, echo, framing=framing, written=1, read=0)
    return Request(
        WriteMultipleRegistersRequest(dev_id=unit, address=address, registers=values),
        WriteMultipleRegistersResponse(dev_id=unit, address=address, count=count),
        framing=framing,
        written=count,
        read=0,
    )


def read_write_request(
    framing: Framing, unit: int, read_address: int, read_count: int, write_address: int, write_count: int
) -> Request:
    """Create a request that writes one block of registers and reads another, function 23."""
    return Request(
        ReadWriteMultipleRegistersRequest(
            dev_id=unit,
            read_address=read_address,
            read_count=read_count,
            write_address=write_address,
            write_registers=[0] * write_count,
        ),
        ReadWriteMultipleRegistersResponse(dev_id=unit, registers=[0] * read_count),
        framing=framing,
        written=write_count,
        read=read_count,
    )


def _framer(framing: Framing) -> FramerBase:
    return FramerSocket(DecodePDU(False)) if framing == "tcp" else FramerRTU(DecodePDU(False))
