"""Conversion between a physical value and the bytes of a Modbus register."""

import struct
from math import nan

from piezod.config.link import Register
from piezod.errors import ConfigurationError

_TYPES = {"int16": "h", "uint16": "H", "int32": "i", "float32": "f"}
_LIMITS = {
    "int16": (-(2.0**15), 2.0**15 - 1),
    "uint16": (0.0, 2.0**16 - 1),
    "int32": (-(2.0**31), 2.0**31 - 1),
    "float32": (-(2.0 - 2.0**-23) * 2.0**127, (2.0 - 2.0**-23) * 2.0**127),
}

_JUST_UNDER_HALF = 0.499  # a raw value this far outside the range still rounds into it

Buffer = bytearray | memoryview


class RegisterCodec:
    """Encoder and decoder of one register: `value = raw * scale + offset`, with raw in type and byte order.

    The letters ABCD are the bytes of the big-endian number, written in their order on the wire::

        0x12345678   ABCD: 12 34 56 78   CDAB: 56 78 12 34   BADC: 34 12 78 56   DCBA: 78 56 34 12

    Parameters
    ----------
    register
        Type, order, scale, offset, low and high.
    order
        Byte order in place of the one of `register`.
    """

    __slots__ = (
        "_high",
        "_is_float",
        "_low",
        "_offset",
        "_raw_high",
        "_raw_low",
        "_scale",
        "_struct",
        "_swap",
        "_type",
        "size",
    )

    def __init__(self, register: Register, order: str | None = None) -> None:
        byte_order = order or register.byte_order
        self.size = 2 * register.words
        self._type = register.type
        self._is_float = register.type == "float32"
        self._raw_low, self._raw_high = _LIMITS[register.type]
        if not self._is_float:
            self._raw_low, self._raw_high = self._raw_low - _JUST_UNDER_HALF, self._raw_high + _JUST_UNDER_HALF
        self._scale, self._offset = register.scale, register.offset
        self._low = -float("inf") if register.low is None else register.low
        self._high = float("inf") if register.high is None else register.high
        little = byte_order in ("BA", "DCBA")
        self._struct = struct.Struct(("<" if little else ">") + _TYPES[register.type])
        self._swap = swap_positions(byte_order)

    def pack_into(self, buffer: Buffer, at: int, value: float) -> float:
        """Write `value` into `buffer`, starting at byte `at`.

        Returns
        -------
        float
            The encoded value, after rounding. nan: `value` cannot be encoded or lies outside low..high of the register,
            and the buffer is unchanged.
        """
        raw = (value - self._offset) / self._scale
        if not (self._low <= value <= self._high and self._raw_low <= raw <= self._raw_high):
            return nan
        code = self._struct
        if self._is_float:
            code.pack_into(buffer, at, raw)
            (raw,) = code.unpack_from(buffer, at)
        else:
            raw = round(raw)
            code.pack_into(buffer, at, raw)
        if self._swap:
            self._swap_bytes(buffer, at)
        return raw * self._scale + self._offset

    def unpack_from(self, buffer: Buffer | bytes, at: int) -> float:
        """Decode the value in `buffer` that starts at byte `at`."""
        if self._swap:
            word = bytearray(buffer[at : at + 4])
            self._swap_bytes(word, 0)
            (raw,) = self._struct.unpack(word)
        else:
            (raw,) = self._struct.unpack_from(buffer, at)
        return float(raw) * self._scale + self._offset

    def check_encodable(self, low: float, high: float, name: str) -> None:
        """Check that the register can hold both ends of a range.

        Raises
        ------
        ConfigurationError
            One end of the range does not fit.
        """
        scratch = bytearray(self.size)
        ends = sorted(raw * self._scale + self._offset for raw in _LIMITS[self._type])
        first, last = max(ends[0], self._low), min(ends[1], self._high)
        for value in (low, high):
            encoded = self.pack_into(scratch, 0, value)
            if encoded != encoded:  # noqa: PLR0124 - nan
                raise ConfigurationError(
                    f"{name}: {value:g} cannot be encoded, must be within {first:g} and {last:g}; "
                    "change the limits, or the register's type, scale or offset"
                )

    def _swap_bytes(self, buffer: Buffer, at: int) -> None:
        a, b, c, d = self._swap
        buffer[at], buffer[at + 1], buffer[at + 2], buffer[at + 3] = (
            buffer[at + a],
            buffer[at + b],
            buffer[at + c],
            buffer[at + d],
        )


def swap_positions(byte_order: str) -> tuple[int, ...]:
    """Positions in the big-endian number, for the mixed orders CDAB and BADC; empty for other orders."""
    return tuple("ABCD".index(letter) for letter in byte_order) if byte_order in ("CDAB", "BADC") else ()
