"""Opening of a TCP or TLS connection to one device, and the reasons for a failure."""

import contextlib
import os
import select
import socket
import ssl
from typing import Any

from piezod.config.link import ModbusTcpLink, RtuOverTcpLink
from piezod.errors import PiezodError, UnreachableError
from piezod.runtime import clock, sockets
from piezod.transport.tls import REFUSAL_S as TLS_REFUSAL_S
from piezod.transport.tls import TlsStream, tls_error

REFUSAL_S = 0.01  # a device with a single client closes a second connection within this time

Connection = socket.socket | TlsStream
TcpLink = ModbusTcpLink | RtuOverTcpLink
Address = Any  # tuple whose members depend on the address family


def resolve(config: TcpLink) -> list[Any]:
    """Addresses of the host, as `socket.getaddrinfo` returns them.

    Raises
    ------
    UnreachableError
        The host name is unknown.
    """
    host, port = config.host, config.port
    try:
        return sockets.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise UnreachableError(
            f"link: {host}:{port} cannot be resolved ({error}): check link.host and the name server"
        ) from error


def connect(
    config: TcpLink, family: int, address: Address, context: ssl.SSLContext | None, deadline_s: float
) -> Connection:
    """Open a non-blocking connection.

    Parameters
    ----------
    config
        Host and TLS settings.
    family, address
        One result of `resolve`.
    context
        TLS context; None: plain TCP.
    deadline_s
        Time limit on the monotonic clock [s].

    Raises
    ------
    OSError
        The device refuses, does not answer in time, or the TLS handshake fails.
    """
    connection = sockets.socket(family, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
    try:
        _connect_socket(connection, address, deadline_s)
        if context is None:
            return connection
        name = config.tls.server_name if config.tls is not None else None
        return TlsStream(connection, context, name or config.host, deadline_s)
    except BaseException:
        connection.close()
        raise


def _connect_socket(connection: socket.socket, address: Address, deadline_s: float) -> None:
    connection.setblocking(False)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    with contextlib.suppress(BlockingIOError):
        connection.connect(address)
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


def is_turned_away(connection: Connection, waiter: "select.poll | TlsStream") -> bool:
    """Whether the device closes the new connection at once, because it already serves another client.

    Raises
    ------
    OSError
        The connection was reset, or the device refused the TLS certificate.
    """
    if isinstance(connection, TlsStream):
        if connection.poll(1e3 * TLS_REFUSAL_S) and connection.reason:
            raise ssl.SSLError(1, connection.reason)
        return connection.ended
    return bool(waiter.poll(1e3 * REFUSAL_S)) and not connection.recv(1, socket.MSG_PEEK)


def connection_error(config: TcpLink, error: OSError) -> PiezodError:
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
