"""The ASCII line protocol: one line a request, at most one line an answer, `ERR <code>` for what is refused.

Codes: 1 no such command, 2 not a number, 3 out of range.
"""

import asyncio
import contextlib
import math
import re
from collections.abc import Callable

from firmware_sim.config import Line, LineCommand
from firmware_sim.errors import PortBusyError, RefusedError
from firmware_sim.firmware.device import IDENTITY, MAP_VERSION, Device

UNKNOWN_COMMAND, NO_NUMBER, OUT_OF_RANGE = 1, 2, 3
LONGEST_LINE = 1024

Fields = dict[str, float]
Action = Callable[[Fields], None]


class LineProtocol:
    """A device behind lines of text.

    Parameters
    ----------
    device
        Which answers.
    settings
        The lines it understands.
    """

    def __init__(self, device: Device, settings: Line) -> None:
        self._device = device
        self._end = settings.terminator.encode("ascii")
        self._bytes = b""
        actions: tuple[tuple[LineCommand, Action], ...] = (
            (settings.set_voltage, self._set_voltage),
            (settings.measure, _nothing),
            (settings.identify, _nothing),
            (settings.ask_watchdog, _nothing),
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


class LineConnection(asyncio.Protocol):
    """A TCP client of the line protocol."""

    def __init__(self, device: Device, settings: Line) -> None:
        self._lines = LineProtocol(device, settings)
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the client."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Answer whole lines."""
        reply = self._lines.received(data)
        if reply and self._transport is not None:
            self._transport.write(reply)


async def serve_lines(device: Device, settings: Line, port: int) -> asyncio.Server:
    """Open the line protocol's TCP port.

    Raises
    ------
    PortBusyError
        Another program holds it.
    """
    loop = asyncio.get_running_loop()
    try:
        return await loop.create_server(lambda: LineConnection(device, settings), settings.host, port)
    except OSError as error:
        raise PortBusyError(f"{settings.host}:{port} cannot be served: {error.strerror}") from None


def _nothing(fields: Fields) -> None:
    del fields


def _number(text: str) -> float:
    if re.fullmatch(r"[-+0-9.eE]+", text):
        with contextlib.suppress(ValueError):
            value = float(text)
            if math.isfinite(value):
                return value
    raise RefusedError(NO_NUMBER, f"not a number: {text!r}")
