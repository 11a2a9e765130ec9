"""Request templates and the replies they must get, built once by pymodbus' own PDU and framer classes.

The tick patches value bytes, transaction id or CRC into the template; nothing is encoded there::

    TCP  [ tid | 0 0 | length | unit ][ function | ... | values ]             tid: 2 bytes, counts requests
    RTU                       [ unit ][ function | ... | values ][ CRC ]      CRC: 2 bytes

    function 23   read address | read count | write address | write count | byte count | values
                  -> byte count | registers
    function 3, 4 address | count                                -> byte count | registers
    function 16   address | count | byte count | values          -> address | count
    function 6    address | value                                -> address | value
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
    """One request as it stands on the wire, and what its good reply begins with.

    Attributes
    ----------
    frame
        The whole request; value bytes, transaction id and CRC are patched in place.
    values_at
        Where the written values begin in `frame`; 0 when nothing is written.
    reply_head
        What the good reply begins with: all of it but registers and CRC.
    reply_size
        Length of the good reply [bytes].
    payload_at
        Where the registers begin in the reply.
    unit_at
        Where the unit stands, in request and reply; the function follows it.
    reads
        The reply carries registers.
    mirrors_values
        The reply repeats the value (function 6).
    values, checksum
        The bytes of `frame` that change, up to the CRC, and the checksum of those before.
    reply_fixed, reply_checksum
        How many bytes of the good reply never change, and their checksum.
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
        """Expect the values that stand in `frame` in the reply too."""
        self.reply_head[-2:] = self.frame[self.values_at : self.values_at + 2]


def crc16(frame: memoryview, checksum: int = 0xFFFF) -> int:
    """Checksum of the bytes, continued from `checksum`; 0 for a good frame together with its own.

    The table is that of pymodbus' `FramerRTU`.
    """
    table = _CRC_TABLE
    for byte in frame:
        checksum = checksum >> 8 ^ table[(checksum ^ byte) & 255]
    return checksum


def classify(reply: bytearray, request: Request, size: int) -> tuple[ExchangeResult, int]:
    """Say why a whole frame is not the good reply to `request`.

    Parameters
    ----------
    reply
        Begins with the frame.
    request
        What was asked.
    size
        Length of the frame without its CRC [bytes].

    Returns
    -------
    tuple
        What is wrong, and the exception code or 0.
    """
    unit_at, head = request.unit_at, request.reply_head
    if reply[unit_at] != head[unit_at]:
        return ExchangeResult.WRONG_UNIT, 0
    function, asked = reply[unit_at + 1], head[unit_at + 1]
    if function == asked | 0x80 and size == unit_at + 3:
        return ExchangeResult.DEVICE_EXCEPTION, reply[unit_at + 2]
    return (ExchangeResult.WRONG_COUNT if function == asked else ExchangeResult.WRONG_FUNCTION), 0


def read_request(framing: Framing, unit: int, function: int, address: int, count: int) -> Request:
    """Build a request that reads `count` registers with function 3 or 4."""
    ask: Callable[..., ModbusPDU] = ReadInputRegistersRequest if function == 4 else ReadHoldingRegistersRequest
    answer: Callable[..., ModbusPDU] = ReadInputRegistersResponse if function == 4 else ReadHoldingRegistersResponse
    return Request(
        ask(dev_id=unit, address=address, count=count),
        answer(dev_id=unit, registers=[0] * count),
        framing=framing,
        written=0,
        read=count,
    )


def write_request(framing: Framing, unit: int, function: int, address: int, count: int) -> Request:
    """Build a request that writes `count` registers with function 16, or one with function 6."""
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
    """Build a request that writes one block and reads another, function 23."""
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
