"""Modbus TCP: the socket framer of pymodbus on an asyncio protocol, with optional TLS."""

import asyncio
import ssl

from pymodbus.framer import FramerSocket
from pymodbus.pdu import ExceptionResponse

from firmware_sim.config import Tcp, Tls
from firmware_sim.errors import ConfigurationError, PortBusyError
from firmware_sim.firmware.modbus import ModbusUnit

LONGEST_ADU = 260
GATEWAY_NO_RESPONSE = 11


class ModbusTcpProtocol(asyncio.Protocol):
    """The connection of one client.

    Parameters
    ----------
    unit
        Modbus unit that executes the requests.
    settings
        Unit id, and whether a second client is refused.
    clients
        Open connections, shared by all protocols of a server.
    """

    def __init__(self, unit: ModbusUnit, settings: Tcp, clients: set[asyncio.Transport]) -> None:
        self._unit = unit
        self._settings = settings
        self._clients = clients
        self._framer = FramerSocket(unit.decoder)
        self._transport: asyncio.Transport | None = None
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Accept the client; with `one_client`, close the connection of a second client at once."""
        assert isinstance(transport, asyncio.Transport)
        if self._settings.one_client and self._clients:
            transport.abort()
            return
        self._transport = transport  # asyncio has set TCP_NODELAY
        self._clients.add(transport)

    def connection_lost(self, error: Exception | None) -> None:
        """Remove the client."""
        del error
        if self._transport is not None:
            self._clients.discard(self._transport)
            self._transport = None

    def data_received(self, data: bytes) -> None:
        """Answer every complete frame; close the connection when the bytes cannot be Modbus."""
        received = self._received + data if self._received else data
        while self._transport is not None:
            used, unit_id, transaction_id, frame = self._framer.decode(received)
            if used == 0:
                break
            received = received[used:]
            self._answer(frame, unit_id, transaction_id)
        self._received = received
        if self._transport is not None and not _may_become_a_frame(received):
            self._transport.abort()

    def _answer(self, frame: bytes, unit_id: int, transaction_id: int) -> None:
        assert self._transport is not None
        if not frame:
            self._transport.abort()
            return
        if unit_id in (self._settings.unit_id, 0, 255):
            reply = self._unit.reply(frame, unit_id, transaction_id)
        else:
            reply = ExceptionResponse(frame[0] & 0x7F, GATEWAY_NO_RESPONSE, unit_id, transaction_id)
        self._transport.write(self._framer.buildFrame(reply))


def _may_become_a_frame(received: bytes) -> bool:
    """Return whether the received bytes can begin a frame: protocol 0, length 2 to 254."""
    if received[2:4].strip(b"\0"):
        return False
    return len(received) < 6 or 2 <= int.from_bytes(received[4:6], "big") <= LONGEST_ADU - 6


async def serve_tcp(unit: ModbusUnit, settings: Tcp) -> asyncio.Server:
    """Open the Modbus TCP port.

    Raises
    ------
    PortBusyError
        Another program holds the port.
    ConfigurationError
        Certificate, key or CA cannot be used.
    """
    loop = asyncio.get_running_loop()
    clients: set[asyncio.Transport] = set()
    context = None if settings.tls is None else _context(settings.tls)
    try:
        return await loop.create_server(
            lambda: ModbusTcpProtocol(unit, settings, clients), settings.host, settings.port, ssl=context
        )
    except OSError as error:
        raise PortBusyError(f"{settings.host}:{settings.port} cannot be served: {error.strerror}") from None


def _context(tls: Tls) -> ssl.SSLContext:
    """Build a TLS context that presents the certificate of the device and requires one of every client."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.verify_mode = ssl.CERT_REQUIRED
    try:
        context.load_cert_chain(tls.certificate, tls.key)
        context.load_verify_locations(cafile=tls.ca)
    except (OSError, ssl.SSLError) as error:
        raise ConfigurationError(f"tcp.tls: {tls.certificate}, {tls.key} or {tls.ca} cannot be used: {error}") from None
    return context
