"""The values of a tick: encoded into the request, decoded from the reply, and checked."""

import struct
import sys
from math import isfinite, nan
from operator import itemgetter

from piezod.config.link import Register
from piezod.errors import ConfigurationError
from piezod.runtime import chance, clock
from piezod.transport.frames import Request
from piezod.transport.link import ExchangeResult, Reading
from piezod.transport.registers import RegisterCodec, swap_positions

QUANTITIES = {"force": 0, "voltage_readback": 1, "temperature": 2, "reference": 3}  # role -> slot
COUNTERS = {"heartbeat": 0, "command_echo": 1, "status": 2, "reference_counter": 3}
_HIGHEST = sys.float_info.max  # finite values lie within +- this value
_COUNTS = 65536  # counters are compared modulo 16 bits
_HALF = 32768  # a larger advance is a step backwards
_UNKNOWN_AFTER_S = 5.0  # since the last reading: a device of 6,554 samples a second has then passed the half

_OK = ExchangeResult.OK


class SetPoint:
    """The values written in a tick: voltage and command number.

    Parameters
    ----------
    registers
        Registers by role, in ascending order of address without gaps.

    Attributes
    ----------
    counts
        Whether the device has a register for the command number.
    """

    __slots__ = ("_modulus", "_sequence", "_sequence_at", "_voltage", "_voltage_at", "has_sequence", "sequence")

    def __init__(self, registers: dict[str, Register]) -> None:
        _check_counters(registers)
        first = next(iter(registers.values())).address
        voltage = registers["voltage_setpoint"]
        self._voltage = RegisterCodec(voltage)
        self._voltage_at = 2 * (voltage.address - first)
        self.has_sequence = "command_sequence" in registers
        self._sequence: RegisterCodec | None = None
        self._sequence_at, self._modulus, self.sequence = 0, _COUNTS, 0
        if self.has_sequence:
            counter = registers["command_sequence"]
            self._sequence = RegisterCodec(counter)
            self._sequence_at = 2 * (counter.address - first)
            self._modulus = _HALF if counter.type == "int16" else _COUNTS
            self.sequence = chance.below(self._modulus)  # two programs that start together do not count alike

    def encode_into(self, request: Request, voltage_V: float) -> float:
        """Encode voltage [V] and next command number into `request`.

        Returns
        -------
        float
            The encoded voltage [V] after rounding. nan: it cannot be encoded, and `request` is unchanged.
        """
        at = request.values_at
        written_V = self._voltage.pack_into(request.frame, at + self._voltage_at, voltage_V)
        if written_V != written_V:  # noqa: PLR0124 - nan
            return nan
        if self._sequence is not None:
            self.sequence = (self.sequence + 1) % self._modulus
            self._sequence.pack_into(request.frame, at + self._sequence_at, self.sequence)
        if request.mirrors_values:
            request.mirror_values()
        return written_V


class Plausibility:
    """Checks of heartbeat and command echo; copies accepted values into `reading`.

    Parameters
    ----------
    heartbeat_within_s
        Longest time with an unchanged heartbeat [s]; 0: the heartbeat must advance in each exchange.

    Attributes
    ----------
    values, counters
        Decoded values by slot (`QUANTITIES`, `COUNTERS`), not yet checked.
    reading
        Last accepted values.
    """

    __slots__ = (
        "_accepted_s",
        "_advanced_s",
        "_has_echo",
        "_has_heartbeat",
        "_heartbeat",
        "_heartbeat_known",
        "_within_s",
        "counters",
        "reading",
        "values",
    )

    def __init__(self, roles: frozenset[str], heartbeat_within_s: float) -> None:
        self.values = [nan] * len(QUANTITIES)
        self.counters = [0] * len(COUNTERS)
        self.reading = Reading()
        self._has_heartbeat = "heartbeat" in roles
        self._has_echo = "command_echo" in roles
        self._heartbeat = 0
        self._heartbeat_known = False
        self._within_s = heartbeat_within_s
        self._accepted_s = self._advanced_s = 0.0

    def forget_heartbeat(self) -> None:
        """Accept any next heartbeat, because the device may have restarted."""
        self._heartbeat_known = False

    def accept(self, expected_echo: int) -> ExchangeResult:
        """Check heartbeat and echo, then copy the values into `reading`. A negative `expected_echo` is not compared."""
        heartbeat, echo, status, reference_counter = self.counters
        if self._has_echo and expected_echo >= 0 and (echo - expected_echo) % _COUNTS:
            return ExchangeResult.ECHO_MISMATCH
        if self._has_heartbeat and self._heartbeat_known:
            advance = (heartbeat - self._heartbeat) % _COUNTS
            now_s = clock.monotonic()
            backwards = advance >= _HALF and now_s - self._accepted_s < _UNKNOWN_AFTER_S
            if backwards or (advance == 0 and now_s - self._advanced_s >= self._within_s):
                return ExchangeResult.HEARTBEAT_STOOD
            self._accepted_s = now_s
            if advance:
                self._advanced_s = now_s
        elif self._has_heartbeat:
            self._accepted_s = clock.monotonic()
        self._heartbeat, self._heartbeat_known = heartbeat, True
        reading = self.reading
        reading.force_N, reading.voltage_readback_V, reading.temperature_C, reading.reference_N = self.values
        reading.heartbeat = heartbeat
        reading.command_echo = echo
        reading.status = status
        reading.reference_counter = reference_counter
        return _OK


class ReadBlock:
    """The block of registers read in a tick, decoded by one struct call.

    Parameters
    ----------
    registers
        Registers by role, in ascending order of address; gaps are skipped.
    """

    __slots__ = ("_bytes", "_counters", "_quantities", "_struct", "count", "first")

    def __init__(self, registers: dict[str, Register]) -> None:
        _check_counters(registers)
        members = list(registers.values())
        self.first = members[0].address
        self.count = members[-1].address + members[-1].words - self.first
        code = ">"
        positions: list[int] = []
        for register in members:
            at = 2 * (register.address - self.first)
            code += (
                "x" * (at - len(positions)) + {"int16": "h", "uint16": "H", "int32": "i", "float32": "f"}[register.type]
            )
            positions.extend(range(len(positions), at))
            positions.extend(at + k for k in _big_endian_positions(register.byte_order))
        self._struct = struct.Struct(code)
        plain = positions == list(range(2 * self.count))
        self._bytes = None if plain else itemgetter(*positions)
        self._quantities = tuple(
            (
                k,
                QUANTITIES[role],
                register.scale,
                register.offset,
                -_HIGHEST if register.low is None else register.low,
                _HIGHEST if register.high is None else register.high,
            )
            for k, (role, register) in enumerate(registers.items())
            if role in QUANTITIES
        )
        self._counters = tuple((k, COUNTERS[role]) for k, role in enumerate(registers) if role in COUNTERS)

    def decode(self, buffer: memoryview, at: int, values: list[float], counters: list[int]) -> ExchangeResult:
        """Decode the registers from byte `at` on into `values` and `counters`, by slot."""
        if self._bytes is None:
            raw = self._struct.unpack_from(buffer, at)
        else:
            raw = self._struct.unpack(bytes(self._bytes(buffer[at : at + self._struct.size])))
        for k, slot, scale, offset, low, high in self._quantities:
            value = raw[k] * scale + offset
            if not low <= value <= high:
                return ExchangeResult.OUT_OF_RANGE if isfinite(value) else ExchangeResult.NOT_FINITE
            values[slot] = value
        for k, slot in self._counters:
            counters[slot] = raw[k]
        return _OK


def _big_endian_positions(byte_order: str) -> tuple[int, ...]:
    """Positions of the bytes of the big-endian number on the wire."""
    if byte_order in ("BA", "DCBA"):
        return tuple(range(len(byte_order)))[::-1]
    return swap_positions(byte_order) or tuple(range(len(byte_order)))


def _check_counters(registers: dict[str, Register]) -> None:
    """Refuse counters and status bits that are not plain integers."""
    for role in ("command_sequence", *COUNTERS):
        register = registers.get(role)
        if register is None:
            continue
        where = f"registers.{role}"
        if register.type == "float32":
            raise ConfigurationError(
                f"{where}.type is float32, must be uint16, int16 or int32: it is a counter or status bits"
            )
        if (register.scale, register.offset, register.low, register.high) != (1.0, 0.0, None, None):
            raise ConfigurationError(
                f"{where} has scale, offset, low or high, must have none: it is a counter or status bits"
            )
