"""Opening of a TCP or TLS connection to one device, and the reasons for a failure."""

import contextlib
import os
import select
import socket
import ssl
from typing import Any, NamedTuple

from piezod.config.link import ModbusTcpLink, RtuOverTcpLink
from piezod.errors import BusyError, ConfigurationError, PiezodError, UnreachableError
from piezod.runtime import clock, sockets
from piezod.transport.tls import REFUSAL_S as TLS_REFUSAL_S
from piezod.transport.tls import TlsStream, tls_error

REFUSAL_S = 0.01  # a device with a single client closes a second connection within this time

Connection = socket.socket | TlsStream
TcpLink = ModbusTcpLink | RtuOverTcpLink


class Endpoint(NamedTuple):
    """One resolved address of a host."""

    family: int
    address: Any  # tuple whose members depend on the family


def connect_to_host(config: TcpLink, context: ssl.SSLContext | None) -> tuple[Connection, Endpoint]:
    """Connect to the first address of the host that accepts; a host name may have several.

    Raises
    ------
    UnreachableError
        The host is unknown, refuses, or does not answer within `connect_timeout_s`.
    BusyError
        The peer closed the connection at once.
    ConfigurationError
        The host name leads to a routable address, but the link is not encrypted.
    """
    endpoints = _resolve(config)
    deadline_s, failure = clock.monotonic() + config.connect_timeout_s, OSError("no address")
    for endpoint in endpoints:
        if message := config.plaintext_refusal(endpoint.address[0]):
            raise ConfigurationError(f"link.{message}")
        try:
            connection = _connect_and_stay(config, endpoint, context, deadline_s)
        except OSError as error:
            failure = error
            continue
        if connection is not None:
            return connection, endpoint
        peer = "gateway" if isinstance(config, RtuOverTcpLink) else "device"
        doubt = "" if context is None else ", or it refuses link.tls.certificate"
        raise BusyError(
            f"link: {config.host}:{config.port} closed the connection at once: "
            f"another client may hold the {peer}{doubt}; stop it first"
        )
    raise _connection_error(config, failure) from failure


def _resolve(config: TcpLink) -> list[Endpoint]:
    """Addresses of the host; raises UnreachableError."""
    host, port = config.host, config.port
    try:
        found = sockets.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise UnreachableError(
            f"link: {host}:{port} cannot be resolved ({error}): check link.host and the name server"
        ) from error
    return [Endpoint(family, address) for family, _, _, _, address in found]


def _connect_and_stay(
    config: TcpLink, endpoint: Endpoint, context: ssl.SSLContext | None, deadline_s: float
) -> Connection | None:
    """Connect; None: the peer closes the new connection at once, because it already serves another client."""
    try:
        connection = connect(config, endpoint, context, deadline_s)
    except ConnectionResetError:
        return None
    try:
        if not _is_turned_away(connection):
            return connection
    except ConnectionResetError:
        pass
    except BaseException:
        connection.close()
        raise
    connection.close()
    return None


def connect(config: TcpLink, endpoint: Endpoint, context: ssl.SSLContext | None, deadline_s: float) -> Connection:
    """Open a non-blocking connection.

    Parameters
    ----------
    config
        Host and TLS settings.
    endpoint
        Address from `connect_to_host`.
    context
        TLS context; None: plain TCP.
    deadline_s
        Time limit on the monotonic clock [s].

    Raises
    ------
    OSError
        The device refuses, does not answer in time, or the TLS handshake fails.
    """
    connection = sockets.socket(endpoint.family, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        _connect_socket(connection, endpoint, deadline_s)
        if context is None:
            return connection
        name = config.tls.server_name if config.tls is not None else None
        return TlsStream(connection, context, name or config.host, deadline_s)
    except BaseException:
        connection.close()
        raise


def _connect_socket(connection: socket.socket, endpoint: Endpoint, deadline_s: float) -> None:
    connection.setblocking(False)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with contextlib.suppress(BlockingIOError):
        connection.connect(endpoint.address)
    waiter = sockets.poll()
    waiter.register(connection, select.POLLOUT)
    if not waiter.poll(max(0.0, 1e3 * (deadline_s - clock.monotonic()))):
        raise TimeoutError
    error = connection.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if error:
        raise OSError(error, os.strerror(error))


def input_waiter(connection: Connection) -> "select.poll | TlsStream":
    """Object whose `poll` waits for input on the connection."""
    if isinstance(connection, TlsStream):
        return connection
    waiter = sockets.poll()
    waiter.register(connection, select.POLLIN)
    return waiter


def _is_turned_away(connection: Connection) -> bool:
    """Whether the peer closes the new connection at once; raises OSError on a reset or a refused TLS certificate."""
    if isinstance(connection, TlsStream):
        if connection.poll(1e3 * TLS_REFUSAL_S) and connection.reason:
            raise ssl.SSLError(1, connection.reason)
        return connection.ended
    return bool(input_waiter(connection).poll(1e3 * REFUSAL_S)) and not connection.recv(1, socket.MSG_PEEK)


def _connection_error(config: TcpLink, error: OSError) -> PiezodError:
    """Convert a failure of `connect` into an error with cause and remedy."""
    where = f"link: {config.host}:{config.port}"
    if isinstance(config, ModbusTcpLink) and (refused := tls_error(config, error)) is not None:
        return refused
    if isinstance(error, ConnectionRefusedError):
        return UnreachableError(f"{where} refused the connection: is the device on, and the port right?")
    if isinstance(error, TimeoutError):
        limit_s = config.connect_timeout_s
        return UnreachableError(f"{where} did not answer within {limit_s:g} s: check cable, address and firewall")
    return UnreachableError(f"{where}: {error.strerror or error}: check network and address")
