"""The line protocol on TCP; on a pseudo-terminal, `pty.py` serves it."""

import asyncio

from firmware_sim.config import Line
from firmware_sim.errors import PortBusyError
from firmware_sim.firmware.device import Device
from firmware_sim.firmware.line import LineProtocol


class LineConnection(asyncio.Protocol):
    """The connection of one TCP client.

    Parameters
    ----------
    settings
        Commands, replies and terminator.
    """

    def __init__(self, device: Device, settings: Line) -> None:
        self._lines = LineProtocol(device, settings)
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Store the transport of the client."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """Answer every complete line."""
        reply = self._lines.received(data)
        if reply and self._transport is not None:
            self._transport.write(reply)


async def serve_lines(device: Device, settings: Line, port: int) -> asyncio.Server:
    """Open the TCP port of the line protocol.

    Raises
    ------
    PortBusyError
        Another program holds the port.
    """
    loop = asyncio.get_running_loop()
    try:
        return await loop.create_server(lambda: LineConnection(device, settings), settings.host, port)
    except OSError as error:
        raise PortBusyError(f"{settings.host}:{port} cannot be served: {error.strerror}") from None
