"""Executes Modbus requests on the registers of the device; pymodbus decodes and encodes them."""

from pymodbus.constants import ExcCodes
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
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

from firmware_sim.errors import RefusedError
from firmware_sim.firmware.device import Device

SERVED = (3, 4, 6, 16, 23)  # Modbus function codes


class ModbusUnit:
    """One Modbus unit that serves a device.

    Parameters
    ----------
    device
        Device whose registers are served.
    """

    def __init__(self, device: Device) -> None:
        self.device = device
        self.decoder = DecodePDU(is_server=True)

    def reply(self, frame: bytes, unit_id: int, transaction_id: int) -> ModbusPDU:
        """Return the reply to a request, given as function code and data."""
        function = frame[0]
        answer = self._answer(frame, function)
        answer.dev_id = unit_id
        answer.transaction_id = transaction_id
        return answer

    def _answer(self, frame: bytes, function: int) -> ModbusPDU:
        if function not in SERVED:
            return ExceptionResponse(function & 0x7F, ExcCodes.ILLEGAL_FUNCTION)
        request = self.decoder.decode(frame)
        if request is None:
            return ExceptionResponse(function, ExcCodes.ILLEGAL_VALUE)
        try:
            return self._execute(request)
        except RefusedError as refusal:
            return ExceptionResponse(function, refusal.code)

    def _execute(self, request: ModbusPDU) -> ModbusPDU:
        device = self.device
        if isinstance(request, ReadWriteMultipleRegistersRequest):
            _check_counts(request.write_count, request.write_byte_count, len(request.write_registers), 121)
            device.check_readable(request.read_address, request.read_count)
            device.write(request.write_address, request.write_registers)
            words = device.read(request.read_address, request.read_count)
            return ReadWriteMultipleRegistersResponse(registers=words)
        if isinstance(request, ReadInputRegistersRequest):
            return ReadInputRegistersResponse(registers=device.read(request.address, request.count))
        if isinstance(request, ReadHoldingRegistersRequest):
            return ReadHoldingRegistersResponse(registers=device.read(request.address, request.count))
        if isinstance(request, WriteMultipleRegistersRequest):
            _check_counts(request.count, request.byte_count, len(request.registers), 123)
            device.write(request.address, [int(word) for word in request.registers])
            return WriteMultipleRegistersResponse(address=request.address, count=request.count)
        assert isinstance(request, WriteSingleRegisterRequest)
        device.write(request.address, [int(word) for word in request.registers])
        return WriteSingleRegisterResponse(address=request.address, registers=request.registers)


def _check_counts(count: int, byte_count: int | None, words: int, most: int) -> None:
    """Raise `RefusedError` with code 3 for counts that contradict the payload or exceed the limit."""
    if not 1 <= count <= most or byte_count != 2 * count or words != count:
        raise RefusedError(ExcCodes.ILLEGAL_VALUE, f"{count} registers announced, {words} sent")
