"""Modbus RTU: the RTU framer of pymodbus on bytes that arrive in any pieces."""

from collections.abc import Callable

from pymodbus.framer import FramerRTU

from firmware_sim.firmware.modbus import ModbusUnit

SILENCE_NS = 50_000_000  # far above the 3.5 characters of the standard: a pseudo-terminal has no baud rate
LONGEST_ADU = 256


class RtuStation:
    """One Modbus RTU station on a serial line.

    Parameters
    ----------
    unit
        Modbus unit that executes the requests.
    unit_id
        Address on the line, 1 to 247. Requests to other addresses are ignored; requests to 0 get no reply.
    now_ns
        Monotonic clock [ns].
    """

    def __init__(self, unit: ModbusUnit, unit_id: int, now_ns: Callable[[], int]) -> None:
        self._unit = unit
        self._unit_id = unit_id
        self._now_ns = now_ns
        self._framer = FramerRTU(unit.decoder)
        self._bytes = b""
        self._last_ns = 0

    def received(self, data: bytes) -> bytes:
        """Return the reply to the request that these bytes complete; empty while it is incomplete."""
        now_ns = self._now_ns()
        if now_ns - self._last_ns > SILENCE_NS:
            self._bytes = b""
        self._last_ns = now_ns
        self._bytes += data
        used, unit_id, _, frame = self._framer.decode(self._bytes)
        if used == 0:
            self._bytes = self._bytes[-LONGEST_ADU:]
            return b""
        self._bytes = self._bytes[used:]
        if not frame or unit_id not in (0, self._unit_id):
            return b""
        reply = self._framer.buildFrame(self._unit.reply(frame, unit_id, 0))
        return reply if unit_id else b""
