"""The command that the device holds, compared with the last one written: a second master leaves another.

Where the set point itself can be read, the bytes of voltage and number must be those of the last request. Another
voltage is then found however small the difference is. Where only an echo of the number can be read, the number must be
the last one sent; a second master that writes the voltage alone is then seen by the voltage readback only.
"""

from piezod.config.link import Register
from piezod.transport.frames import Request, read_request
from piezod.transport.link import ExchangeResult
from piezod.transport.registers import RegisterCodec
from piezod.transport.wire import Wire


class HeldSetPoint:
    """Reads the registers of the set point and compares them with the request that wrote them.

    Parameters
    ----------
    wire, unit_id
        Wire and unit of the device.
    writes
        Registers that the tick writes, by role, in ascending order of address without gaps.
    written
        Request of the tick; its frame holds the last values sent.
    """

    __slots__ = ("_at", "_bytes", "_number", "_written", "request")

    def __init__(self, wire: Wire, unit_id: int, writes: dict[str, Register], written: Request) -> None:
        members = list(writes.values())
        first, words = members[0].address, sum(register.words for register in members)
        self.request = read_request(wire.framing, unit_id, 3, first, words)
        self._written, self._at, self._bytes = written, written.values_at, 2 * words
        counter = writes.get("command_sequence")
        at = 0 if counter is None else 2 * (counter.address - first)
        self._number = slice(at, at + (0 if counter is None else 2 * counter.words))

    def compare(self, wire: Wire, number: int) -> ExchangeResult:
        """Compare the reply to `request` with the last values sent; `number` is in them already."""
        del number
        sent = self._written.frame[self._at : self._at + self._bytes]
        held = wire.payload[self.request.payload_at : self.request.payload_at + self._bytes]
        if held == sent:
            return ExchangeResult.OK
        number_agrees = held[self._number] == sent[self._number]
        return ExchangeResult.SETPOINT_CHANGED if number_agrees else ExchangeResult.FOREIGN_COMMAND


class HeldNumber:
    """Reads the echo of the command number.

    Parameters
    ----------
    wire, unit_id
        Wire and unit of the device.
    register
        Register in which the device echoes the number.
    """

    __slots__ = ("_codec", "request")

    def __init__(self, wire: Wire, unit_id: int, register: Register) -> None:
        function = 4 if register.function == 4 else 3
        self.request = read_request(wire.framing, unit_id, function, register.address, register.words)
        self._codec = RegisterCodec(register)

    def compare(self, wire: Wire, number: int) -> ExchangeResult:
        """Compare the reply to `request` with the last number sent, modulo 16 bits."""
        held = int(self._codec.unpack_from(wire.payload, self.request.payload_at))
        return ExchangeResult.FOREIGN_COMMAND if (held - number) % 0x10000 else ExchangeResult.OK
