"""The ASCII line protocol: one line per request, at most one line per reply.

A refused request is answered with `ERR <code>`: 1 no such command, 2 not a number, 3 out of range.
"""

import contextlib
import math
import re
from collections.abc import Callable

from firmware_sim.config import Line, LineCommand
from firmware_sim.errors import RefusedError
from firmware_sim.firmware.device import IDENTITY, MAP_VERSION, Device

UNKNOWN_COMMAND, NOT_A_NUMBER, OUT_OF_RANGE = 1, 2, 3
LONGEST_LINE = 1024

Fields = dict[str, float]
Action = Callable[[Fields], None]


class LineProtocol:
    """Serves a device by lines of text.

    Parameters
    ----------
    settings
        Commands, replies and terminator.
    """

    def __init__(self, device: Device, settings: Line) -> None:
        self._device = device
        self._end = settings.terminator.encode("ascii")
        self._bytes = b""
        actions: tuple[tuple[LineCommand, Action], ...] = (
            (settings.set_voltage, self._set_voltage),
            (settings.measure, _no_action),
            (settings.identify, _no_action),
            (settings.ask_watchdog, _no_action),
            (settings.set_watchdog, self._set_watchdog),
        )
        self._commands = [(command.pattern(), command.reply, action) for command, action in actions]

    def received(self, data: bytes) -> bytes:
        """Return the replies to the lines that these bytes complete."""
        *lines, self._bytes = (self._bytes + data).split(self._end)
        self._bytes = self._bytes[-LONGEST_LINE:]
        return b"".join(self._answer(line.decode("ascii", "replace").strip()) for line in lines)

    def _answer(self, line: str) -> bytes:
        try:
            reply = self._execute(line)
        except RefusedError as refusal:
            reply = f"ERR {refusal.code}"
        return reply.encode("ascii") + self._end if reply is not None else b""

    def _execute(self, line: str) -> str | None:
        for pattern, reply, action in self._commands:
            match = pattern.fullmatch(line)
            if match:
                action({name: _number(text) for name, text in match.groupdict().items()})
                return reply.format(**self._values()) if reply is not None else None
        if not line:
            return None
        raise RefusedError(UNKNOWN_COMMAND, f"no such command: {line!r}")

    def _values(self) -> dict[str, float]:
        sample = self._device.sample()
        return {
            "force_N": sample.force_N,
            "voltage_V": sample.voltage_readback_V,
            "heartbeat": sample.heartbeat,
            "command_echo": self._device.command_echo,
            "status": sample.status,
            "temperature_C": sample.temperature_C,
            "watchdog_ms": self._device.watchdog_ms,
            "identity": IDENTITY,
            "map_version": MAP_VERSION,
            "serial_number": self._device.serial_number,
        }

    def _set_voltage(self, fields: Fields) -> None:
        self._device.command(fields["voltage_V"])

    def _set_watchdog(self, fields: Fields) -> None:
        timeout_ms = fields["watchdog_ms"]
        if not 0 <= timeout_ms <= 65535:
            raise RefusedError(OUT_OF_RANGE, f"watchdog is {timeout_ms} ms, must be 0 to 65535")
        self._device.write(110, [int(timeout_ms)])


def _no_action(fields: Fields) -> None:
    del fields


def _number(text: str) -> float:
    if re.fullmatch(r"[-+0-9.eE]+", text):
        with contextlib.suppress(ValueError):
            value = float(text)
            if math.isfinite(value):
                return value
    raise RefusedError(NOT_A_NUMBER, f"not a number: {text!r}")
