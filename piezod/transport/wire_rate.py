"""The highest tick rate of a serial line."""

from piezod.config.link import LinkConfig, ModbusRtuLink, ModbusTcpLink, Register, RtuOverTcpLink, SerialLineLink

GAP_CHARACTERS = 3.5  # silence between two RTU frames: MODBUS over Serial Line 1.02, 2.5.1.1
FIXED_GAP_S = 0.00175  # alternative above 19200 baud, same section

_READ_OVERHEAD = 8 + 5  # unit, function, address, count, CRC; unit, function, byte count, CRC
_WRITE_OVERHEAD = {16: 9 + 8, 6: 6 + 6}
_READ_WRITE_OVERHEAD = 13 + 5


def max_wire_rate_Hz(config: LinkConfig) -> float | None:
    """Highest tick rate of the wire [Hz] if the device answers without delay; None: TCP has no such limit."""
    if isinstance(config, ModbusTcpLink):
        return None
    if isinstance(config, ModbusRtuLink | RtuOverTcpLink):
        characters, gaps = _rtu_characters(config)
        return 1.0 / (characters * config.bits_per_character / config.baudrate + gaps * gap_s(config))
    characters = _line_characters(config)
    return config.baudrate / (characters * config.bits_per_character) if characters else None


def gap_s(config: ModbusRtuLink | RtuOverTcpLink) -> float:
    """Silence at the end of a frame [s]."""
    if config.silent_interval == "fixed" and config.baudrate > 19200:
        return FIXED_GAP_S
    return GAP_CHARACTERS * config.bits_per_character / config.baudrate


def _rtu_characters(config: ModbusRtuLink | RtuOverTcpLink) -> tuple[int, int]:
    """Number of characters and of gaps in one tick."""
    writes, reads = list(config.registers.tick_writes().values()), list(config.registers.tick_reads().values())
    written, read = _span_bytes(writes), _span_bytes(reads)
    if writes and writes[0].function == 23:
        return _READ_WRITE_OVERHEAD + written + read, 2
    characters = gaps = 0
    if writes:
        characters += _WRITE_OVERHEAD[writes[0].function] + written
        characters += written if writes[0].function == 6 else 0
        gaps += 2
    if reads:
        characters += _READ_OVERHEAD + read
        gaps += 2
    return characters, gaps


def _span_bytes(registers: list[Register]) -> int:
    if not registers:
        return 0
    return 2 * (registers[-1].address + registers[-1].words - registers[0].address)


def _line_characters(config: SerialLineLink) -> int:
    """Lowest number of characters in one tick: the shortest voltage, and one character per reply field."""
    end = len(config.terminator)
    characters = 0
    for command in (config.set_voltage, config.measure):
        if command is not None:
            characters += len(command.send.format(voltage_V=0.0)) + end
            if command.reply is not None:
                characters += max(1, command.reply.count("(?P<")) + end
    return characters
